//! What the checks know: the allowed arrows between crates and between modules, the sources of
//! dependencies, the widths of prose.
//!
//! The program (`cargo xtask check`) runs these with formats, lints and docs, and
//! `cargo xtask test` the tests; CI runs the program and nothing else.
#![forbid(unsafe_code)]

pub mod archive;
pub mod arrows;
pub mod command;
pub mod licences;
pub mod modules;
pub mod page;
pub mod paper;
pub mod tests;
pub mod text;
pub mod wheel;

use std::path::{Path, PathBuf};

/// The root of the workspace: the folder above this crate.
pub fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.parent().unwrap_or(here).to_path_buf()
}
