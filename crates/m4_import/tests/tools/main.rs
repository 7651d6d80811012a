//! The made-up clip of `fixtures/import` (made by `oracles/import_formats_a.py`) as every tool of reconstruction leaves it.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod colmap;
mod da3;
mod lenses;
mod megasam;
mod monst3r;
mod nerfstudio;
mod trajectory;
mod truth;
mod vggt;
mod vipe;

use m4_import::SourceFormat;
use truth::fixture;

#[test]
fn every_source_is_told_by_its_files() {
    use SourceFormat::{Colmap, Da3, Kitti, Megasam, Monst3r, Nerfstudio, Tum, Vggt, Vipe};
    for (path, format) in [
        ("import/colmap_text", Colmap),
        ("import/colmap_binary/sparse", Colmap),
        ("import/colmap_binary/sparse/0", Colmap),
        ("import/nerfstudio", Nerfstudio),
        ("import/nerfstudio/transforms.json", Nerfstudio),
        ("import/blender", Nerfstudio),
        ("import/vipe", Vipe),
        ("import/vipe/pose/dog.npz", Vipe),
        ("import/da3", Da3),
        ("import/da3/exports/npz/results.npz", Da3),
        ("import/da3_streaming", Da3),
        ("import/vggt/predictions.npz", Vggt),
        ("import/monst3r", Monst3r),
        ("import/monst3r/pred_traj.txt", Monst3r),
        ("import/tum", Tum),
        ("import/tum/groundtruth.txt", Tum),
        ("import/kitti/poses.txt", Kitti),
        ("import/kitti", Kitti),
        ("megasam/outputs/dog_droid.npz", Megasam),
        ("megasam/outputs_cvd/dog_sgd_cvd_hr.npz", Megasam),
        ("megasam/reconstructions/dog", Megasam),
    ] {
        assert_eq!(m4_import::detect(&fixture(path)), Some(format), "{path}");
    }
    for path in [
        "import",
        "import/clip",
        "import/clip/clip.json",
        "import/clip/images",
        "tracks/numpy.npz",
        "nothing",
    ] {
        assert_eq!(m4_import::detect(&fixture(path)), None, "{path}");
    }
}

#[test]
fn names_are_those_of_the_command_line() {
    let names: Vec<&str> = SourceFormat::all().map(SourceFormat::name).collect();
    for name in [
        "colmap",
        "nerfstudio",
        "vipe",
        "da3",
        "vggt",
        "monst3r",
        "megasam",
        "tum",
        "kitti",
    ] {
        assert!(names.contains(&name), "{name}");
    }
    for format in SourceFormat::all() {
        let written = serde_json::to_string(&format).unwrap();
        assert_eq!(written, format!("{:?}", format.name()));
    }
}
