//! Reading and changing sources.

pub use crate::common::{Heard, copy, fixture, says};
use m4_core::Silent;
use m4_io::dataset::{ImportOptions, SourceFormat, read};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A copy of `fixtures/NAME` that a test may change, and the folder that it is in.
pub fn copied(name: &str) -> (TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let to = dir.path().join("copy");
    copy(&fixture(name), &to);
    (dir, to)
}

/// One text for another in a file; it must be there.
pub fn edit(path: &Path, from: &str, to: &str) {
    let text = std::fs::read_to_string(path).unwrap();
    assert!(text.contains(from), "{} has no {from}", path.display());
    std::fs::write(path, text.replace(from, to)).unwrap();
}

/// Why a source is refused.
pub fn refused(path: &Path, format: SourceFormat, options: &ImportOptions) -> String {
    match read(path, format, options, &Silent) {
        Ok(_) => panic!("{} was taken", path.display()),
        Err(e) => e.to_string(),
    }
}

/// Asserts that a source is refused for a reason that has all of `words`.
#[track_caller]
pub fn refuses(path: &Path, format: SourceFormat, words: &[&str]) {
    says(&refused(path, format, &ImportOptions::default()), words);
}
