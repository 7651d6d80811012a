//! Which format a path is of, and what formats are called.

use crate::dataset::support::fixture;
use m4_io::dataset::SourceFormat;

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
        assert_eq!(m4_io::dataset::detect(&fixture(path)), Some(format), "{path}");
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
    let want = ["dycheck", "nvidia", "record3d", "colmap", "nerfstudio", "vipe", "megasam"];
    assert_eq!(names, want);
    for format in SourceFormat::all() {
        let written = serde_json::to_string(&format).unwrap();
        assert_eq!(written, format!("{:?}", format.name()));
    }
}
