//! COLMAP, as pycolmap 4.2 writes it.

use super::truth::{Truth, read, with_images};
use crate::dataset::support::{copied, copy, fixture, refused};
use m4_io::dataset::ImportOptions;
use m4_io::dataset::SourceFormat::Colmap;

#[test]
fn colmap_text_and_binary_models_agree() {
    let truth = Truth::read();
    for name in [
        "import/colmap_text",
        "import/colmap_binary",
        "import/colmap_binary/sparse/0",
    ] {
        let got = read(name, Colmap, &with_images()).unwrap();
        truth.same_cameras(&got.train, (0, 0.0));
        assert!(got.test.is_none() && !got.train.metric);
        assert_eq!(got.train.time_frames, 5);
        assert_eq!(got.train.frames[3].t, 3.0);
        assert_eq!(got.train.frames[3].name, "00003.png");
        assert!((got.train.duration_s.unwrap() - 4.0 / 30.0).abs() < 1e-12);
    }
}

#[test]
fn images_without_a_pose_leave_a_gap_in_time() {
    let (_dir, here) = copied("import/colmap_text");
    let path = here.join("sparse/0/images.txt");
    let text = std::fs::read_to_string(&path).unwrap();
    // two lines an image
    let mut lines: Vec<&str> = text.lines().collect();
    let at = lines.iter().position(|line| line.ends_with("00002.png")).unwrap();
    lines.drain(at..at + 2);
    std::fs::write(&path, lines.join("\n") + "\n").unwrap();
    let got = m4_io::dataset::read(&here, Colmap, &with_images(), &m4_core::Silent)
        .unwrap()
        .train;
    let times: Vec<f64> = got.frames.iter().map(|f| f.t).collect();
    assert_eq!((times, got.time_frames), (vec![0.0, 1.0, 3.0, 4.0], 5));
}

#[test]
fn colmap_names_may_include_the_images_folder() {
    let dir = tempfile::tempdir().unwrap();
    copy(&fixture("import/colmap_text/sparse/0"), dir.path());
    copy(&fixture("import/clip/images"), &dir.path().join("images"));
    let path = dir.path().join("images.txt");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace(" 7 0000", " 7 images/0000")).unwrap();
    let got = m4_io::dataset::read(dir.path(), Colmap, &ImportOptions::default(), &m4_core::Silent)
        .unwrap()
        .train;
    Truth::read().same_cameras(&got, (0, 0.0));
    assert_eq!(
        (got.frames[4].name.as_str(), got.frames[4].t),
        ("images/00004.png", 4.0)
    );
}

#[test]
fn missing_and_unsupported_colmap_files_are_named() {
    let (dir, here) = copied("import/colmap_text");
    let plain = ImportOptions::default();
    assert!(refused(&here, Colmap, &plain).contains("images"));
    assert!(refused(dir.path(), Colmap, &plain).contains("sparse/0"));
    let change = |file: &str, from: &str, to: &str| {
        let path = here.join("sparse/0").join(file);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{text}");
        std::fs::write(&path, text.replace(from, to)).unwrap();
        let message = refused(&here, Colmap, &with_images());
        std::fs::write(&path, text).unwrap();
        message
    };
    let message = change("cameras.txt", "PINHOLE", "FOV");
    assert!(
        message.contains("FOV") && message.contains("undistort") && message.contains("camera 7"),
        "{message}"
    );
    let message = change("cameras.txt", "7 PINHOLE", "8 PINHOLE");
    assert!(
        message.contains("camera 7") && message.contains("image 20"),
        "{message}"
    );
    let message = change("images.txt", "00002.png", "../00002.png");
    assert!(message.contains("not below"), "{message}");
    let message = change("images.txt", "00002.png", "00009.png");
    assert!(message.contains("00009.png"), "{message}");
    let message = change("cameras.txt", "48 36", "48 37");
    assert!(message.contains("48 x 36") && message.contains("48 x 37"), "{message}");
    let small = ImportOptions {
        max_memory_bytes: 48 * 36 * 8 * 5 - 1,
        ..with_images()
    };
    assert!(refused(&here, Colmap, &small).contains("max_memory_bytes"));
}
