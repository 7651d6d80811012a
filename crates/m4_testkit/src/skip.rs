//! What a machine may lack: tests that cannot run are reported in a list that is visible to the
//! user. The root of the repository, and large inputs in a folder next to it, which may be absent.

use std::fs::OpenOptions;
use std::io::Write;
use std::panic::Location;
use std::path::PathBuf;

/// The file to which every skipped test is added, a line each: need, hint, test, where, why,
/// separated by tabs. `cargo xtask test` sets it, and prints the lines when the tests are done.
pub const SKIPPED_VARIABLE: &str = "MINUTE4D_SKIPPED";

/// Requirement of a test that a machine may lack.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Need {
    /// `ffmpeg`, with the encoders that the test uses.
    Ffmpeg,
    /// A browser.
    Chromium,
    /// A GPU, or a software Vulkan driver (lavapipe).
    Vulkan,
    /// A GPU: a software driver would take too long.
    Gpu,
    /// A GPU that computes with 16 bits.
    HalfPrecision,
    /// npm, and the packages that it fetches.
    Npm,
    /// Python with pip and venv, and the packages that it fetches.
    Pip,
    /// The benchmark scenes and clips beside the repository.
    Shared,
    /// Published weights of a network.
    Weights,
    /// Instructions that the processor lacks.
    Instructions,
}

impl Need {
    /// The name that `cargo xtask test --require` takes, and a hint for installing it.
    pub fn name_and_hint(self) -> (&'static str, &'static str) {
        match self {
            Self::Ffmpeg => ("ffmpeg", "install ffmpeg (apt-get install ffmpeg)"),
            Self::Chromium => (
                "chromium",
                "install Chromium (apt-get install chromium), or name one in MINUTE4D_CHROMIUM",
            ),
            Self::Vulkan => (
                "vulkan",
                "install a Vulkan driver (apt-get install mesa-vulkan-drivers libvulkan1)",
            ),
            Self::Gpu => (
                "gpu",
                "run the tests on a GPU: a software driver takes minutes for each network",
            ),
            Self::HalfPrecision => (
                "half-precision",
                "run the tests on a GPU that computes with 16 bits",
            ),
            Self::Npm => (
                "npm",
                "install Node.js with npm, and let it reach its registry",
            ),
            Self::Pip => (
                "pip",
                "install Python with pip and venv (apt-get install python3-pip python3-venv)",
            ),
            Self::Shared => (
                "shared",
                "put the folder `shared` with the benchmark scenes beside the repository",
            ),
            Self::Weights => ("weights", "get the weights (docs/models.md)"),
            Self::Instructions => ("instructions", "run the tests on a processor that has them"),
        }
    }
}

/// Says that the running test, or a part of it, cannot run here: on stderr, which the harness
/// hides, and in the file that [`SKIPPED_VARIABLE`] names. The test returns after it.
#[track_caller]
#[expect(clippy::print_stderr, reason = "a test that does not run says so")]
pub fn skip(need: Need, why: &str) {
    let thread = std::thread::current();
    let test = thread.name().unwrap_or("a test");
    let place = Location::caller();
    let line = line(
        need,
        test,
        &format!("{}:{}", place.file(), place.line()),
        why,
    );
    eprint!("cannot run here: {line}");
    if let Some(path) = std::env::var_os(SKIPPED_VARIABLE) {
        let added = OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)
            // One call: other processes write lines of their own.
            .and_then(|mut file| file.write_all(line.as_bytes()));
        added.unwrap_or_else(|error| panic!("cannot add to {}: {error}", path.display()));
    }
}

fn line(need: Need, test: &str, place: &str, why: &str) -> String {
    let (name, hint) = need.name_and_hint();
    let fields = [name, hint, test, place, why];
    let fields = fields.map(|field| field.split_whitespace().collect::<Vec<_>>().join(" "));
    fields.join("\t") + "\n"
}

/// Returns the root of the repository.
pub fn repository() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// Path of `name` in `shared` (such as `bench/quad-1`), beside the repository's root; `None` where
/// this machine does not have it, and the test is listed as skipped.
#[track_caller]
pub fn shared(name: &str) -> Option<PathBuf> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")).join(name);
    if path.exists() {
        return Some(path);
    }
    skip(
        Need::Shared,
        &format!("there is no shared/{name} beside the repository"),
    );
    None
}

/// Runs `test` on every level of `available` and lists each name of `wanted` that this machine
/// lacks as skipped, so that a run shows what it did not cover.
#[track_caller]
pub fn on_every_level<L: Copy>(
    available: &[L],
    name: impl Fn(L) -> &'static str,
    wanted: &[&str],
    mut test: impl FnMut(L),
) {
    assert!(
        !available.is_empty(),
        "no SIMD level: nothing would be tested"
    );
    for missing in wanted
        .iter()
        .filter(|w| !available.iter().any(|&l| name(l) == **w))
    {
        skip(Need::Instructions, &format!("not tested on {missing}"));
    }
    for &level in available {
        test(level);
    }
}

#[cfg(test)]
mod tests {
    use super::{Need, line, on_every_level};

    #[test]
    fn a_skipped_test_is_one_line_of_five_fields() {
        let line = line(
            Need::Ffmpeg,
            "video::plays",
            "tests/video.rs:7",
            "not\tfound\nanywhere",
        );
        let fields: Vec<&str> = line.trim_end_matches('\n').split('\t').collect();
        let expected = [
            "ffmpeg",
            Need::Ffmpeg.name_and_hint().1,
            "video::plays",
            "tests/video.rs:7",
            "not found anywhere",
        ];
        assert_eq!(fields, expected);
    }

    #[test]
    fn every_level_runs_once() {
        let mut levels = Vec::new();
        on_every_level(&["a", "b"], |l| l, &["a", "c"], |l| levels.push(l));
        assert_eq!(levels, ["a", "b"]);
    }

    #[test]
    #[should_panic(expected = "nothing would be tested")]
    fn no_level_is_a_failure() {
        on_every_level::<&'static str>(&[], |l| l, &[], |_| {});
    }
}
