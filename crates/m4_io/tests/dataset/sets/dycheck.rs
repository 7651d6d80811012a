//! `fixtures/import/dycheck`: five frames of camera 0, one each of cameras 1 and 2, depth in millimetres.

use super::truth::*;
use crate::dataset::support::{Heard, copied, edit, fixture, refused};
use m4_io::dataset::dycheck::covisible;
use m4_io::dataset::{ImportOptions, SourceFormat, read};
use m4_io::image;

const FORMAT: SourceFormat = SourceFormat::Dycheck;

#[test]
fn dycheck_matches_the_clip_it_was_written_from() {
    let path = fixture("import/dycheck");
    let heard = Heard::default();
    let clip = read(&path, FORMAT, &ImportOptions::default(), &heard).unwrap();
    assert!(heard.all().contains("thousandths"), "{}", heard.all());
    let train = &clip.train;
    assert_poses(train, "c2w");
    assert_true_lens(train);
    assert_images(train, &truth("rgb"), 0.0, 0.0);
    let depth = truth("depth");
    for i in 0..5 {
        assert_depth(train, i, &depth[i * W * H..(i + 1) * W * H], 1e-6, |x, y| {
            y > 0 || x >= 4
        });
    }
    assert_near(&times(train), &[0.0, 1.0, 2.0, 3.0, 4.0], 0.0);
    assert_eq!((train.time_frames, train.metric), (5, true));
    assert!((train.duration_s.unwrap() - 0.4).abs() < 1e-12);
    assert!(train.frames.iter().all(|f| f.camera_index.is_none()));

    let test = clip.test.unwrap();
    assert_poses(&test, "test_c2w");
    assert_images(&test, &truth("test_rgb"), 0.0, 0.0);
    assert_near(&times(&test), &[1.0, 3.0], 0.0);
    let cameras: Vec<_> = test.frames.iter().map(|f| f.camera_index).collect();
    assert_eq!(cameras, [Some(1), Some(2)]);
    for (i, frame) in test.frames.iter().enumerate() {
        let mask = image::read_mask(&covisible(&path, &frame.name, None)).unwrap();
        assert_eq!(mask.count(), H * (W - 8 * (i + 1)));
        assert!(frame.depth.is_none());
    }
}

#[test]
fn dycheck_without_splits_uses_dataset_lists() {
    let (_dir, path) = copied("import/dycheck");
    std::fs::remove_dir_all(path.join("splits")).unwrap();
    std::fs::remove_file(path.join("extra.json")).unwrap();
    let heard = Heard::default();
    let clip = read(&path, FORMAT, &ImportOptions::default(), &heard).unwrap();
    assert!(heard.all().contains("30 frames per second"), "{}", heard.all());
    assert_poses(&clip.train, "c2w");
    assert!((clip.train.duration_s.unwrap() - 4.0 / 30.0).abs() < 1e-12);
    assert_eq!(clip.test.unwrap().frames.len(), 2);
    // a clip of which every second frame is held out, and one of another camera
    edit(
        &path.join("dataset.json"),
        r#""train_ids": ["0_00000", "0_00001", "0_00002", "0_00003", "0_00004"], "val_ids": ["1_00001", "2_00003"]"#,
        r#""train_ids": ["0_00000", "0_00002", "0_00004", "1_00001"], "val_ids": ["0_00001", "0_00003", "2_00003"]"#,
    );
    let heard = Heard::default();
    let clip = read(&path, FORMAT, &ImportOptions::default(), &heard).unwrap();
    assert!(heard.all().contains("1 of 4 training frames"), "{}", heard.all());
    assert_near(&times(&clip.train), &[0.0, 1.0, 2.0], 0.0);
    assert_near(&times(&clip.test.unwrap()), &[0.5, 1.5, 1.5], 1e-12);
}

#[test]
fn depth_unit_fits_the_scene() {
    let depth = |path: &std::path::Path, options: &ImportOptions| {
        let clip = import(path, FORMAT, options).unwrap();
        let depth = clip.train.frames[1].depth.clone().unwrap();
        (
            f64::from(depth.at(20, 20)) / truth("depth")[W * H + 20 * W + 20],
            clip.train.metric,
        )
    };
    let (_dir, path) = copied("import/dycheck");
    let given = ImportOptions {
        depth_unit: Some(0.002),
        ..ImportOptions::default()
    };
    assert!((depth(&path, &given).0 - 2.0).abs() < 1e-5);
    // a scene whose places are millimetres too
    edit(
        &path.join("scene.json"),
        r#""near": 0.3, "far": 1.125"#,
        r#""near": 300.0, "far": 1125.0"#,
    );
    let (ratio, metric) = depth(&path, &ImportOptions::default());
    assert!((ratio - 1000.0).abs() < 1e-2 && !metric);
    std::fs::remove_file(path.join("scene.json")).unwrap();
    assert!((depth(&path, &ImportOptions::default()).0 - 1.0).abs() < 1e-5);
}

#[test]
fn nerfstudio_lens_keys_are_parsed_or_refused() {
    let (_dir, path) = copied("import/dycheck");
    for i in 0..5 {
        let file = path.join(format!("camera/0_{i:05}.json"));
        edit(
            &file,
            r#""radial_distortion": [0, 0, 0]"#,
            r#""radial_distortion": [-0.2, 0.05, 0]"#,
        );
    }
    let clip = import(&path, FORMAT, &ImportOptions::default()).unwrap();
    // a barrel lens saw more than a pinhole of its focal length: the pinhole that shows all of it is shorter
    let (k, want) = (clip.train.frames[0].camera.intrinsics, truth("k"));
    assert!(k.fx < want[0] * 0.99 && k.fx > want[0] * 0.9, "{k:?}");
    assert!((k.fx / k.fy - want[0] / want[4]).abs() < 1e-9, "{k:?}");
    let file = path.join("camera/0_00002.json");
    edit(&file, r#""skew": 0.0"#, r#""skew": 0.5"#);
    let why = refused(&path, FORMAT, &ImportOptions::default());
    assert!(why.contains("0_00002.json") && why.contains("skew is 0.5"), "{why}");
}

#[test]
fn malformed_dycheck_is_rejected_with_file_and_reason() {
    let factor = ImportOptions {
        factor: Some(4),
        ..ImportOptions::default()
    };
    let why = refused(&fixture("import/dycheck"), FORMAT, &factor);
    assert!(why.contains("rgb/4x is missing") && why.contains("factor"), "{why}");
    let broken = |file: &str, from: &str, to: &str, says: &[&str]| {
        let (_dir, path) = copied("import/dycheck");
        edit(&path.join(file), from, to);
        let why = refused(&path, FORMAT, &ImportOptions::default());
        assert!(says.iter().all(|s| why.contains(s)), "{why}");
    };
    broken(
        "camera/0_00001.json",
        "[[",
        "[[9",
        &["0_00001.json", "orientation", "not a rotation"],
    );
    broken(
        "camera/0_00001.json",
        r#""focal_length": 100.0"#,
        r#""focal_length": -1"#,
        &["focal lengths -1"],
    );
    broken(
        "camera/0_00001.json",
        "[96, 72]",
        "[72, 96]",
        &["0_00001.png", "rotated"],
    );
    broken(
        "splits/train.json",
        r#""time_ids": [4, "#,
        r#""time_ids": ["#,
        &["train.json", "4 time_ids"],
    );
    broken(
        "splits/train.json",
        r#""time_ids": [4, "#,
        r#""time_ids": [3, "#,
        &["of one moment"],
    );
    broken("splits/val.json", "1_00001", "../../x", &["not the name of a frame"]);
    broken("splits/val.json", "1_00001", "0_00001", &["both splits"]);
    broken(
        "scene.json",
        r#""scale": 0.25"#,
        r#""scale": 0"#,
        &["scene.json", "scale 0"],
    );
    broken(
        "extra.json",
        r#""fps": 10.0"#,
        r#""fps": 0.0"#,
        &["extra.json", "fps is 0"],
    );
}
