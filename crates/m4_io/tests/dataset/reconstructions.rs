//! COLMAP as pycolmap 4.2 writes it, images that OpenCV drew through lenses, artifacts of ViPE (EXR
//! files by OpenEXR 3.5), and `transforms.json` of nerfstudio, Instant4D, D-NeRF and our own
//! captures.

use super::truth::{SIZE, Truth, beside, colour, read_fixture, with_images};
use crate::dataset::{Heard, copied, copy, edit, fixture, refused, refuses, says};
use m4_core::Silent;
use m4_io::capture::Split;
use m4_io::dataset::SourceFormat::{Colmap, Nerfstudio, Vipe};
use m4_io::dataset::{ImportOptions, read as import};

#[test]
fn colmap_text_and_binary_models_agree() {
    let truth = Truth::read();
    for name in [
        "import/colmap_text",
        "import/colmap_binary",
        "import/colmap_binary/sparse/0",
    ] {
        let got = read_fixture(name, Colmap, &with_images()).unwrap();
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
    let at = lines
        .iter()
        .position(|line| line.ends_with("00002.png"))
        .unwrap();
    lines.drain(at..at + 2);
    std::fs::write(&path, lines.join("\n") + "\n").unwrap();
    let got = import(&here, Colmap, &with_images(), &Silent)
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
    let got = import(dir.path(), Colmap, &ImportOptions::default(), &Silent)
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
    says(
        &change("cameras.txt", "PINHOLE", "FOV"),
        &["FOV", "undistort", "camera 7"],
    );
    says(
        &change("cameras.txt", "7 PINHOLE", "8 PINHOLE"),
        &["camera 7", "image 20"],
    );
    says(
        &change("images.txt", "00002.png", "../00002.png"),
        &["not below"],
    );
    says(
        &change("images.txt", "00002.png", "00009.png"),
        &["00009.png"],
    );
    says(
        &change("cameras.txt", "48 36", "48 37"),
        &["48 x 36", "48 x 37"],
    );
    let small = ImportOptions {
        max_memory_bytes: 48 * 36 * 8 * 5 - 1,
        ..with_images()
    };
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
        let got = read_fixture(name, format, &beside()).unwrap().train;
        assert_eq!(got.frames.len(), 2);
        for (i, frame) in got.frames.iter().enumerate() {
            truth.same_pose(i, frame);
            let k = frame.camera.intrinsics;
            assert_eq!((k.width, k.height), SIZE);
            assert_eq!([k.cx, k.cy], [truth.intrinsics[2], truth.intrinsics[3]]);
            // a barrel sees further to the sides: the lens that shows all of it, and nothing
            // beyond, is shorter
            let shorter = k.fx / truth.intrinsics[0];
            assert!(
                (0.9..0.995).contains(&shorter) && (k.fx / k.fy - 50.0 / 52.0).abs() < 1e-12,
                "{k:?}"
            );
            let mut off = Vec::new();
            for p in 0..SIZE.0 * SIZE.1 {
                let (u, v) = (p % SIZE.0, p / SIZE.0);
                let want = colour(
                    i,
                    (u as f64 + 0.5 - k.cx) / k.fx,
                    (v as f64 + 0.5 - k.cy) / k.fy,
                );
                let actual = frame.rgb[(u, v)];
                off.extend((0..3).map(|c| (f64::from(actual[c]) - want[c]).abs()));
            }
            let worst = off.iter().copied().fold(0.0, f64::max);
            let mean = off.iter().sum::<f64>() / off.len() as f64;
            // rounding twice and bilinear sampling; without undistortion the worst is above 10
            assert!(
                worst < 2.5 && mean < 0.5,
                "{name}, frame {i}: {worst}, {mean}"
            );
        }
    }
}

#[test]
fn vipe_matches_the_clip_it_was_written_from() {
    let truth = Truth::read();
    for name in ["import/vipe", "import/vipe/pose/dog.npz"] {
        let got = read_fixture(name, Vipe, &ImportOptions::default())
            .unwrap()
            .train;
        // 4:2:0 video
        truth.same_cameras(&got, (24, 5.0));
        // halves: 11 bits
        truth.same_depth(&got, 1.0 / 2048.0, 0.0);
        // the sky is an instance that does not move
        truth.same_masks(&got);
        let ids = got.frames[1].instances.as_ref().unwrap();
        assert_eq!([ids.at(0, 0), ids.at(13, 12), ids.at(5, 30)], [1, 2, 0]);
        assert!(got.metric);
        assert!(
            (got.duration_s.unwrap() - 0.4).abs() < 1e-3,
            "{:?}",
            got.duration_s
        );
    }
    let got = read_fixture("import/vipe", Vipe, &with_images())
        .unwrap()
        .train;
    truth.same_cameras(&got, (0, 0.0));
}

#[test]
fn missing_and_unsupported_vipe_files_are_named() {
    let (_dir, here) = copied("import/vipe");
    let plain = ImportOptions::default();
    std::fs::write(
        here.join("intrinsics/dog_camera.txt"),
        "0: PINHOLE\n1: MEI\n",
    )
    .unwrap();
    refuses(&here, Vipe, &["MEI", "line 2"]);
    std::fs::remove_file(here.join("intrinsics/dog_camera.txt")).unwrap();
    std::fs::rename(here.join("rgb/dog.mp4"), here.join("rgb/cat.mp4")).unwrap();
    refuses(&here, Vipe, &["rgb/dog.mp4", "images"]);
    std::fs::rename(here.join("rgb/cat.mp4"), here.join("rgb/dog.mp4")).unwrap();
    for part in ["pose", "intrinsics"] {
        std::fs::copy(
            here.join(part).join("dog.npz"),
            here.join(part).join("cat.npz"),
        )
        .unwrap();
    }
    refuses(&here, Vipe, &["cat, dog"]);
    // depth and masks may be missing
    std::fs::remove_dir_all(here.join("depth")).unwrap();
    std::fs::remove_dir_all(here.join("mask")).unwrap();
    let got = import(&here.join("pose/dog.npz"), Vipe, &plain, &Silent)
        .unwrap()
        .train;
    assert!(
        got.frames.len() == 5
            && got
                .frames
                .iter()
                .all(|f| f.depth.is_none() && f.mask.is_none())
    );
}

#[test]
fn applied_transform_and_scale_are_undone() {
    let truth = Truth::read();
    let got = read_fixture("import/nerfstudio", Nerfstudio, &ImportOptions::default()).unwrap();
    // images are JPEG
    truth.same_cameras(&got.train, (12, 2.0));
    // millimetres
    truth.same_depth(&got.train, 0.0, 0.000_501);
    truth.same_masks(&got.train);
    assert_eq!(got.train.frames[4].name, "images/frame_5.jpg");
    assert_eq!(got.train.frames[4].t, 4.0);
}

#[test]
fn axes_and_masks_follow_the_keys_of_the_file() {
    let truth = Truth::read();
    let heard = Heard::default();
    let path = fixture("import/instant4d");
    let got = import(&path, Nerfstudio, &beside(), &heard).unwrap().train;
    truth.same_cameras(&got, (0, 0.0));
    assert!(heard.all().contains("OpenCV axes were assumed"));
    // depth in an npy file, in steps of a thousandth too
    let z = got.frames[2].depth.as_ref().unwrap().at(11, 7);
    assert!((f64::from(z) - truth.depth[2][7 * SIZE.0 + 11]).abs() < 1e-6);
    assert!(got.frames[1].depth.is_none());
    let dir = tempfile::tempdir().unwrap();
    for name in ["instant4d", "clip"] {
        copy(&fixture("import").join(name), &dir.path().join(name));
    }
    let path = dir.path().join("instant4d");
    edit(
        &path.join("transforms.json"),
        r#"{"w""#,
        r#"{"camera_model": "OPENCV", "w""#,
    );
    let got = import(&path, Nerfstudio, &beside(), &Silent).unwrap().train;
    let (a, b) = (got.frames[0].camera.c2w.rotation, truth.c2w[0].rotation);
    assert!((a.column(2) + b.column(2)).amax() < 1e-9 && (a.column(0) - b.column(0)).amax() < 1e-9);
}

#[test]
fn nerfstudio_training_and_test_splits_are_read() {
    let truth = Truth::read();
    let got = read_fixture("import/blender", Nerfstudio, &beside()).unwrap();
    let test = got.test.unwrap();
    assert_eq!(
        (
            got.train.frames.len(),
            got.train.time_frames,
            test.frames.len()
        ),
        (3, 3, 2)
    );
    for (frames, indices) in [
        (&got.train.frames, &[0, 2, 4][..]),
        (&test.frames, &[1, 3][..]),
    ] {
        for (frame, &i) in frames.iter().zip(indices) {
            truth.same_pose(i, frame);
            truth.same_image(i, &frame.rgb, (0, 0.0));
            let k = frame.camera.intrinsics;
            // one field of view, and the middle of the image
            let off = [k.fx - 50.0, k.fy - 50.0, k.cx - 24.0, k.cy - 18.0].map(f64::abs);
            assert!(off.into_iter().fold(0.0, f64::max) < 1e-9, "{k:?}");
            assert_eq!(frame.t, i as f64 / 2.0);
        }
    }
}

#[test]
fn our_own_captures_round_trip_through_nerfstudio() {
    let truth = Truth::read();
    let mut capture = read_fixture("import/nerfstudio", Nerfstudio, &ImportOptions::default())
        .unwrap()
        .train;
    capture.duration_s = Some(0.75);
    capture.metric = true;
    let dir = tempfile::tempdir().unwrap();
    m4_io::capture::write(dir.path(), &capture, Split::Train, &Silent).unwrap();
    let got = import(dir.path(), Nerfstudio, &ImportOptions::default(), &Silent)
        .unwrap()
        .train;
    truth.same_cameras(&got, (12, 2.0));
    truth.same_masks(&got);
    assert_eq!((got.metric, got.duration_s), (true, Some(0.75)));
    for (a, b) in got.frames.iter().zip(&capture.frames) {
        assert_eq!(a.rgb, b.rgb);
        for (a, b) in a
            .depth
            .as_ref()
            .unwrap()
            .every(1)
            .zip(b.depth.as_ref().unwrap().every(1))
        {
            assert!((a - b).abs() < 1e-3);
        }
    }
}

#[test]
fn listed_filenames_split_training_and_test() {
    let (_dir, here) = copied("import/nerfstudio");
    let file = here.join("transforms.json");
    let text = std::fs::read_to_string(&file).unwrap();
    let name = |i: usize| format!("\"images/frame_{i}.jpg\"");
    let lists = format!(
        "{{\"train_filenames\": [{}, {}, {}], \"test_filenames\": [{}], ",
        name(1),
        name(3),
        name(5),
        name(2)
    );
    std::fs::write(&file, text.replacen('{', &lists, 1)).unwrap();
    let got = import(&here, Nerfstudio, &ImportOptions::default(), &Silent).unwrap();
    let test = got.test.unwrap();
    let times: Vec<f64> = got.train.frames.iter().map(|f| f.t).collect();
    assert_eq!((times, got.train.time_frames), (vec![0.0, 1.0, 2.0], 3));
    assert_eq!((test.frames.len(), test.frames[0].t), (1, 0.5));
    Truth::read().same_pose(1, &test.frames[0]);
}

#[test]
fn malformed_nerfstudio_is_rejected() {
    let (_dir, here) = copied("import/nerfstudio");
    let file = here.join("transforms.json");
    let text = std::fs::read_to_string(&file).unwrap();
    let check = |from: &str, to: &str, parts: &[&str]| {
        assert!(text.contains(from), "{from}");
        std::fs::write(&file, text.replacen(from, to, 1)).unwrap();
        refuses(&here, Nerfstudio, parts);
    };
    check(
        "\"OPENCV\"",
        "\"EQUIRECTANGULAR\"",
        &["EQUIRECTANGULAR", "OPENCV_FISHEYE"],
    );
    check("\"p2\": 0.0", "\"k4\": 0.5", &["k4 = 0.5"]);
    check(
        "\"applied_scale\": 0.5",
        "\"applied_scale\": 0",
        &["applied_scale"],
    );
}
