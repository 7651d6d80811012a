//! Reading and changing sources.

pub use crate::common::fixtures::{copy, fixture};
use m4_core::{Progress, Silent};
use m4_io::dataset::{ImportOptions, SourceFormat, read};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
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

/// Records warnings.
#[derive(Default)]
pub struct Heard(Mutex<Vec<String>>);

impl Heard {
    pub fn all(&self) -> String {
        self.0.lock().unwrap().join("\n")
    }
}

impl Progress for Heard {
    fn update(&self, _: &str, _: usize, _: usize, _: &str) {}

    fn cancelled(&self) -> bool {
        false
    }

    fn warn(&self, message: &str) {
        self.0.lock().unwrap().push(message.to_owned());
    }
}
