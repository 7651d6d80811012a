//! COLMAP and nerfstudio: numbers worked out by hand, round trips, and files that are broken.

use super::common::{self, Mutation, asymmetric_scene, mutations};
use m4_core::{
    Scene,
    nalgebra::{Matrix3, Vector3},
};
use m4_io::cameras::colmap::{self, ColmapEncoding, ColmapOptions};
use m4_io::cameras::nerfstudio::{self, NerfstudioOptions};
use std::path::Path;

/// A camera at (1, 2, 3) that looks along x: right is -z, down is y.
fn looking_along_x() -> Scene {
    let mut scene = asymmetric_scene(0);
    let c2w = &mut scene.source[0].camera.c2w;
    c2w.rotation = Matrix3::from_columns(&[-Vector3::z(), Vector3::y(), Vector3::x()]);
    c2w.translation = Vector3::new(1.0, 2.0, 3.0);
    scene.source[1].camera.intrinsics.fx = 90.0;
    scene
}

fn options(encoding: ColmapEncoding) -> ColmapOptions {
    ColmapOptions {
        encoding,
        t: 2.0,
        ..ColmapOptions::default()
    }
}

#[test]
fn colmap_text_by_hand() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("sparse/0");
    let written = colmap::write(&folder, &looking_along_x(), &options(ColmapEncoding::Text)).unwrap();
    let text = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
    let lines = |name: &str| -> Vec<String> {
        let text = text(name);
        text.lines().filter(|l| !l.starts_with('#')).map(String::from).collect()
    };
    assert_eq!(
        lines("cameras.txt"),
        ["1 PINHOLE 64 48 80 75 30 25", "2 PINHOLE 64 48 90 75 30 25"]
    );
    let images = lines("images.txt");
    assert_eq!(images.len(), 18, "two lines an image, the second empty");
    let words: Vec<&str> = images[0].split(' ').collect();
    let numbers: Vec<f64> = words[1..8].iter().map(|w| w.parse().unwrap()).collect();
    // world to camera has the rows -z, y, x: a quarter of a turn about -y, w = 1/sqrt(2) = -y;
    // t = -R c = -(-3, 2, 1)
    let h = std::f64::consts::FRAC_1_SQRT_2;
    for (got, expected) in numbers.iter().zip([h, 0.0, -h, 0.0, 3.0, -2.0, -1.0]) {
        assert!((got - expected).abs() < 1e-12, "{}", images[0]);
    }
    assert_eq!([words[0], words[8], words[9]], ["1", "1", "00000.png"]);
    assert!(images[2].ends_with(" 2 00001.png") && images[4].ends_with(" 1 00002.png"));
    // at frame 2 the moving splat has exactly its opacity of 0.5; colours 0.5 + 0.2821 c
    assert_eq!(
        lines("points3D.txt"),
        ["1 1 2 6 199 128 56 -1", "2 -1 0.5 3 128 255 163 -1"]
    );
    assert_eq!(written.splats, 2);
    let sizes: u64 = ["cameras", "images", "points3D"]
        .map(|n| std::fs::metadata(folder.join(format!("{n}.txt"))).unwrap().len())
        .iter()
        .sum();
    assert_eq!(written.bytes, sizes);
}

#[test]
fn colmap_binary_by_hand() {
    let dir = tempfile::tempdir().unwrap();
    colmap::write(dir.path(), &looking_along_x(), &options(ColmapEncoding::Binary)).unwrap();
    let cameras = std::fs::read(dir.path().join("cameras.bin")).unwrap();
    assert_eq!(cameras.len(), 8 + 2 * (4 + 4 + 8 + 8 + 4 * 8));
    assert_eq!(&cameras[..16], &[2, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0]);
    let images = std::fs::read(dir.path().join("images.bin")).unwrap();
    assert_eq!(images.len(), 8 + 9 * (4 + 7 * 8 + 4 + 10 + 8));
    assert_eq!(&images[8 + 64..8 + 64 + 10], b"00000.png\0");
    let points = std::fs::read(dir.path().join("points3D.bin")).unwrap();
    assert_eq!(points.len(), 8 + 2 * (8 + 24 + 3 + 8 + 8));
    assert_eq!(&points[8 + 32..8 + 35], &[199, 128, 56]);
}

#[test]
fn colmap_comes_back() {
    for encoding in [ColmapEncoding::Text, ColmapEncoding::Binary] {
        let dir = tempfile::tempdir().unwrap();
        let scene = common::random_scene(1, 300, 300);
        let options = ColmapOptions {
            names: Some((0..16).map(|i| format!("train/{i}.jpg")).collect()),
            max_points: 50,
            ..options(encoding)
        };
        let written = colmap::write(dir.path(), &scene, &options).unwrap();
        let model = colmap::read(dir.path()).unwrap();
        assert_eq!(model.images.len(), 16);
        assert!(
            model.points.len() <= 50 && model.points.len() > 25,
            "{}",
            model.points.len()
        );
        assert_eq!(written.splats, model.points.len());
        for (i, (image, frame)) in model.images.iter().zip(&scene.source).enumerate() {
            assert_eq!(image.name, format!("train/{i}.jpg"));
            assert_eq!(image.camera.intrinsics, frame.camera.intrinsics);
            let off = (image.camera.c2w.matrix() - frame.camera.c2w.matrix()).amax();
            assert!(off < 1e-12, "{off}");
        }
    }
}

#[test]
fn nerfstudio_by_hand_and_back() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("transforms.json");
    let scene = looking_along_x();
    nerfstudio::write(&path, &scene, &NerfstudioOptions::default()).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let frame = &json["frames"][0];
    // columns: right -z, up -y, back -x, place
    assert_eq!(
        frame["transform_matrix"],
        serde_json::json!([
            [0.0, 0.0, -1.0, 1.0],
            [0.0, -1.0, 0.0, 2.0],
            [-1.0, 0.0, 0.0, 3.0],
            [0.0, 0.0, 0.0, 1.0]
        ])
    );
    assert_eq!(frame["fl_x"], 80.0);
    assert_eq!(json["frames"][1]["fl_x"], 90.0);
    assert_eq!(json["frames"][2]["time"], 0.25);
    let back = m4_io::trajectory::read(&path, scene.time_frames).unwrap();
    for ((camera, t), frame) in back.iter().zip(&scene.source) {
        assert_eq!(camera, &frame.camera);
        assert_eq!(*t, frame.t);
    }
    // one lens for all is written once
    nerfstudio::write(&path, &asymmetric_scene(0), &NerfstudioOptions::default()).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    assert_eq!(
        (&json["fl_y"], &json["w"], &json["cx"]),
        (&75.0.into(), &64.into(), &30.0.into())
    );
    assert!(json["frames"][0]["fl_x"].is_null());
}

#[test]
fn cameras_that_cannot_be_written_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("out");
    let path = folder.join("transforms.json");
    let check = |scene: &Scene, names: Option<Vec<String>>, expected: &str| {
        let options = ColmapOptions {
            names: names.clone(),
            ..ColmapOptions::default()
        };
        let error = colmap::write(&folder, scene, &options).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        let error = nerfstudio::write(&path, scene, &NerfstudioOptions { names })
            .unwrap_err()
            .to_string();
        assert!(error.contains(expected), "{error}");
    };
    let scene = asymmetric_scene(0);
    check(
        &scene,
        Some(vec!["a.png".into()]),
        "there are 1 names of images and 9 cameras",
    );
    let mut names = vec!["a.png".to_owned(); 9];
    names[4] = "b c.png".into();
    check(&scene, Some(names), "image 4 is called \"b c.png\"");
    let mut none = scene.clone();
    none.source.clear();
    check(&none, None, "no cameras");
    let mut broken = scene;
    broken.source[2].camera.c2w.translation.x = f64::NAN;
    check(&broken, None, "camera 2 of the scene is none");
    assert!(!folder.exists(), "nothing is left behind");
}

/// Reads broken copies of one file of a model; how many were refused.
fn refused(folder: &Path, name: &str) -> usize {
    let path = folder.join(name);
    let whole = std::fs::read(&path).unwrap();
    let mut refused = 0;
    for Mutation { bytes, what } in mutations(&whole, 200) {
        std::fs::write(&path, &bytes).unwrap();
        match colmap::read(folder) {
            Ok(model) => assert!(
                model.images.len() + model.points.len() <= 2 * whole.len(),
                "{name}: {what}"
            ),
            Err(e) => {
                refused += 1;
                assert!(
                    e.to_string().contains(&folder.display().to_string()),
                    "{name}, {what}: {e}"
                );
            }
        }
    }
    std::fs::write(&path, whole).unwrap();
    refused
}

#[test]
fn broken_models_are_refused_without_much_memory() {
    for encoding in [ColmapEncoding::Text, ColmapEncoding::Binary] {
        let dir = tempfile::tempdir().unwrap();
        colmap::write(dir.path(), &common::random_scene(0, 20, 20), &options(encoding)).unwrap();
        let extension = if encoding == ColmapEncoding::Text { "txt" } else { "bin" };
        for (name, least) in [("cameras", 60), ("images", 60), ("points3D", 20)] {
            let refused = refused(dir.path(), &format!("{name}.{extension}"));
            assert!(refused > least, "{name}.{extension}: {refused}");
        }
    }
}

#[test]
fn lenses_with_distortion_are_refused_with_a_way_out() {
    let dir = tempfile::tempdir().unwrap();
    colmap::write(dir.path(), &asymmetric_scene(0), &options(ColmapEncoding::Text)).unwrap();
    let path = dir.path().join("cameras.txt");
    std::fs::write(&path, "1 OPENCV 64 48 80 75 30 25 0.1 0 0 0\n").unwrap();
    let error = colmap::read(dir.path()).unwrap_err().to_string();
    assert!(
        error.contains("OPENCV") && error.contains("image_undistorter"),
        "{error}"
    );
    std::fs::write(&path, "7 SIMPLE_PINHOLE 64 48 80 30 25\n").unwrap();
    let error = colmap::read(dir.path()).unwrap_err().to_string();
    assert!(
        error.contains("image 1 (\"00000.png\") was taken by camera 1, which is not there"),
        "{error}"
    );
    std::fs::write(&path, "1 SIMPLE_PINHOLE 64 48 80 30 x\n").unwrap();
    let error = colmap::read(dir.path()).unwrap_err().to_string();
    assert!(
        error.contains("line 1") && error.contains("PARAMS holds \"x\""),
        "{error}"
    );
}
