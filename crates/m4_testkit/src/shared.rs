//! Large inputs that lie beside the repository and may be absent.

use std::path::PathBuf;

/// The folder of shared inputs beside the repository's root, or `None` (and a line that says so) where
/// this machine does not have it. `test` names the test for that line.
#[must_use]
#[expect(clippy::print_stderr, reason = "a skipped test has to say so")]
pub fn shared_dir(test: &str) -> Option<PathBuf> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared"));
    if path.is_dir() {
        return Some(path);
    }
    eprintln!("{test}: skipped, there is no folder `shared` beside the repository");
    None
}
