//! Data sets as tools, benchmarks and phones leave them, compared with what they were written from.

mod benchmarks;
mod export;
mod megasam;
mod outside;
mod reconstructions;
mod record3d;
mod truth;

pub use crate::common::{copy, fixture, says};
use m4_core::Silent;
use m4_io::dataset::{ImportOptions, SourceFormat, read};
pub use m4_testkit::Heard;
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

#[test]
fn source_formats_are_detected_by_their_files() {
    use SourceFormat::{Colmap, Dycheck, Megasam, Nerfstudio, Nvidia, Record3d, Vipe};
    for (path, format) in [
        ("import/dycheck", Dycheck),
        ("import/nvidia", Nvidia),
        ("import/record3d/clip.r3d", Record3d),
        ("import/colmap_text", Colmap),
        ("import/colmap_binary/sparse", Colmap),
        ("import/colmap_binary/sparse/0", Colmap),
        ("import/nerfstudio", Nerfstudio),
        ("import/nerfstudio/transforms.json", Nerfstudio),
        ("import/blender", Nerfstudio),
        ("import/vipe", Vipe),
        ("import/vipe/pose/dog.npz", Vipe),
        ("megasam/outputs/dog_droid.npz", Megasam),
        ("megasam/outputs_cvd/dog_sgd_cvd_hr.npz", Megasam),
        ("megasam/reconstructions/dog", Megasam),
    ] {
        assert_eq!(
            m4_io::dataset::detect(&fixture(path)),
            Some(format),
            "{path}"
        );
    }
    for path in [
        "import",
        "import/clip",
        "import/clip/clip.json",
        "import/clip/images",
        "import/davis",
        "import/side",
        "tracks/numpy.npz",
        "nothing",
    ] {
        assert_eq!(m4_io::dataset::detect(&fixture(path)), None, "{path}");
    }
}

#[test]
fn names_are_those_of_the_command_line() {
    let names: Vec<&str> = SourceFormat::all().map(SourceFormat::name).collect();
    let want = [
        "dycheck",
        "nvidia",
        "record3d",
        "colmap",
        "nerfstudio",
        "vipe",
        "megasam",
    ];
    assert_eq!(names, want);
    for format in SourceFormat::all() {
        let written = serde_json::to_string(&format).unwrap();
        assert_eq!(written, format!("{:?}", format.name()));
    }
}
