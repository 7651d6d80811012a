//! COLMAP as pycolmap 4.2 writes it, images that OpenCV drew through lenses, and artifacts of ViPE (EXR files by OpenEXR 3.5).

use super::truth_a::{SIZE, Truth, beside, colour, read, with_images};
use crate::dataset::support::{copied, copy, fixture, refused, refuses, says};
use m4_io::dataset::ImportOptions;
use m4_io::dataset::SourceFormat::{Colmap, Nerfstudio, Vipe};

#[test]
fn colmap_text_and_binary_models_agree() {
    let truth = Truth::read();
    for name in ["import/colmap_text", "import/colmap_binary", "import/colmap_binary/sparse/0"] {
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
    let got = m4_io::dataset::read(&here, Colmap, &with_images(), &m4_core::Silent).unwrap().train;
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
    let got = m4_io::dataset::read(dir.path(), Colmap, &ImportOptions::default(), &m4_core::Silent).unwrap().train;
    Truth::read().same_cameras(&got, (0, 0.0));
    assert_eq!((got.frames[4].name.as_str(), got.frames[4].t), ("images/00004.png", 4.0));
}

#[test]
fn missing_and_unsupported_colmap_files_are_named() {
    let (dir, here) = copied("import/colmap_text");
    refuses(&here, Colmap, &["images"]);
    refuses(dir.path(), Colmap, &["sparse/0"]);
    let change = |file: &str, from: &str, to: &str| {
        let path = here.join("sparse/0").join(file);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{text}");
        std::fs::write(&path, text.replace(from, to)).unwrap();
        let message = refused(&here, Colmap, &with_images());
        std::fs::write(&path, text).unwrap();
        message
    };
    says(&change("cameras.txt", "PINHOLE", "FOV"), &["FOV", "undistort", "camera 7"]);
    says(&change("cameras.txt", "7 PINHOLE", "8 PINHOLE"), &["camera 7", "image 20"]);
    says(&change("images.txt", "00002.png", "../00002.png"), &["not below"]);
    says(&change("images.txt", "00002.png", "00009.png"), &["00009.png"]);
    says(&change("cameras.txt", "48 36", "48 37"), &["48 x 36", "48 x 37"]);
    let small = ImportOptions { max_memory_bytes: 48 * 36 * 8 * 5 - 1, ..with_images() };
    assert!(refused(&here, Colmap, &small).contains("max_memory_bytes"));
}

#[test]
fn images_through_lenses_are_as_a_pinhole_sees_them() {
    let truth = Truth::read();
    for (name, format) in [
        ("import/colmap_opencv", Colmap),
        ("import/colmap_fisheye", Colmap),
        ("import/nerfstudio_opencv", Nerfstudio),
        ("import/nerfstudio_fisheye", Nerfstudio),
    ] {
        let got = read(name, format, &beside()).unwrap().train;
        assert_eq!(got.frames.len(), 2);
        for (i, frame) in got.frames.iter().enumerate() {
            truth.same_pose(i, frame);
            let k = frame.camera.intrinsics;
            assert_eq!((k.width, k.height), SIZE);
            assert_eq!([k.cx, k.cy], [truth.intrinsics[2], truth.intrinsics[3]]);
            // a barrel sees further to the sides: the lens that shows all of it, and nothing beyond, is shorter
            let shorter = k.fx / truth.intrinsics[0];
            assert!((0.9..0.995).contains(&shorter) && (k.fx / k.fy - 50.0 / 52.0).abs() < 1e-12, "{k:?}");
            let mut off = Vec::new();
            for p in 0..SIZE.0 * SIZE.1 {
                let (u, v) = (p % SIZE.0, p / SIZE.0);
                let want = colour(i, (u as f64 + 0.5 - k.cx) / k.fx, (v as f64 + 0.5 - k.cy) / k.fy);
                let found = frame.rgb[(u, v)];
                off.extend((0..3).map(|c| (f64::from(found[c]) - want[c]).abs()));
            }
            let worst = off.iter().copied().fold(0.0, f64::max);
            let mean = off.iter().sum::<f64>() / off.len() as f64;
            // rounding twice and bilinear sampling; without undistortion the worst is above 10
            assert!(worst < 2.5 && mean < 0.5, "{name}, frame {i}: {worst}, {mean}");
        }
    }
}

#[test]
fn vipe_matches_the_clip_it_was_written_from() {
    let truth = Truth::read();
    for name in ["import/vipe", "import/vipe/pose/dog.npz"] {
        let got = read(name, Vipe, &ImportOptions::default()).unwrap().train;
        // 4:2:0 video
        truth.same_cameras(&got, (24, 5.0));
        // halves: 11 bits
        truth.same_depth(&got, 1.0 / 2048.0, 0.0);
        // the sky is an instance that does not move
        truth.same_masks(&got);
        let ids = got.frames[1].instances.as_ref().unwrap();
        assert_eq!([ids.at(0, 0), ids.at(13, 12), ids.at(5, 30)], [1, 2, 0]);
        assert!(got.metric);
        assert!((got.duration_s.unwrap() - 0.4).abs() < 1e-3, "{:?}", got.duration_s);
    }
    let got = read("import/vipe", Vipe, &with_images()).unwrap().train;
    truth.same_cameras(&got, (0, 0.0));
}

#[test]
fn missing_and_unsupported_vipe_files_are_named() {
    let (_dir, here) = copied("import/vipe");
    let plain = ImportOptions::default();
    std::fs::write(here.join("intrinsics/dog_camera.txt"), "0: PINHOLE\n1: MEI\n").unwrap();
    refuses(&here, Vipe, &["MEI", "line 2"]);
    std::fs::remove_file(here.join("intrinsics/dog_camera.txt")).unwrap();
    std::fs::rename(here.join("rgb/dog.mp4"), here.join("rgb/cat.mp4")).unwrap();
    refuses(&here, Vipe, &["rgb/dog.mp4", "images"]);
    std::fs::rename(here.join("rgb/cat.mp4"), here.join("rgb/dog.mp4")).unwrap();
    for part in ["pose", "intrinsics"] {
        std::fs::copy(here.join(part).join("dog.npz"), here.join(part).join("cat.npz")).unwrap();
    }
    refuses(&here, Vipe, &["cat, dog"]);
    // depth and masks may be missing
    std::fs::remove_dir_all(here.join("depth")).unwrap();
    std::fs::remove_dir_all(here.join("mask")).unwrap();
    let got = m4_io::dataset::read(&here.join("pose/dog.npz"), Vipe, &plain, &m4_core::Silent).unwrap().train;
    assert!(got.frames.len() == 5 && got.frames.iter().all(|f| f.depth.is_none() && f.mask.is_none()));
}
