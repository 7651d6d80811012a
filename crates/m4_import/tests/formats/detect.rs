//! Which format a path is of, and what formats are called.

use crate::support::fixture;
use m4_import::SourceFormat;

#[test]
fn every_source_is_told_by_its_files() {
    use SourceFormat::{Colmap, Da3, Dycheck, Kitti, Megasam, Monst3r, Nerfstudio, Nvidia, Polycam, Record3d};
    use SourceFormat::{StrayScanner, Tum, Vggt, Vipe};
    for (path, format) in [
        ("import/dycheck", Dycheck),
        ("import/nvidia", Nvidia),
        ("import/record3d/clip.r3d", Record3d),
        ("import/polycam", Polycam),
        ("import/stray", StrayScanner),
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
        "import/davis",
        "import/side",
        "tracks/numpy.npz",
        "nothing",
    ] {
        assert_eq!(m4_import::detect(&fixture(path)), None, "{path}");
    }
}

#[test]
fn names_are_those_of_the_command_line() {
    let names: Vec<&str> = SourceFormat::all().map(SourceFormat::name).collect();
    let want = [
        "dycheck",
        "nvidia",
        "record3d",
        "polycam",
        "stray-scanner",
        "colmap",
        "nerfstudio",
        "vipe",
        "da3",
        "megasam",
        "vggt",
        "monst3r",
        "tum",
        "kitti",
    ];
    assert_eq!(names, want);
    for format in SourceFormat::all() {
        let written = serde_json::to_string(&format).unwrap();
        assert_eq!(written, format!("{:?}", format.name()));
    }
}
