//! The root of the repository, and large inputs in a folder next to it, which may be absent.

use crate::{Need, skip};
use std::path::PathBuf;

/// Returns the root of the repository.
#[must_use]
pub fn repository() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// Path of `name` in `shared` (such as `bench/quad-1`), beside the repository's root; `None` where this machine does
/// not have it, and the test is listed as skipped.
#[must_use]
#[track_caller]
pub fn shared(name: &str) -> Option<PathBuf> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")).join(name);
    if path.exists() {
        return Some(path);
    }
    skip(Need::Shared, &format!("there is no shared/{name} beside the repository"));
    None
}
