//! Clips of DAVIS, NVIDIA and DyCheck, compared with what `oracles/import_formats_b.py` wrote them
//! from.

use super::truth::*;
use crate::dataset::{Heard, copied, edit, fixture, refused, refuses, says};
use m4_io::dataset::davis::detect;
use m4_io::dataset::dycheck::covisible;
use m4_io::dataset::{ImportOptions, SourceFormat, read};
use m4_io::image;

#[test]
fn davis_folders_are_detected() {
    assert!(
        detect(&fixture("import/davis/JPEGImages/480p/ball")) && !detect(&fixture("import/davis"))
    );
}

fn own(name: &str) -> Vec<f64> {
    array("nvidia/truth.npz", name)
}

#[test]
fn nvidia_matches_the_clip_it_was_written_from() {
    let heard = Heard::default();
    let clip = read(
        &fixture("import/nvidia"),
        SourceFormat::Nvidia,
        &ImportOptions::default(),
        &heard,
    )
    .unwrap();
    assert!(heard.all().contains("disp"), "{}", heard.all());
    let train = &clip.train;
    assert_poses(train, "c2w");
    assert_images(train, &own("rgb"), 0.0, 0.0);
    let mask = truth_mask();
    for (i, frame) in train.frames.iter().enumerate() {
        assert_lens(frame, [50.0, 50.0, 24.0, 18.0]);
        let count = frame.mask.as_ref().unwrap().count();
        // of a lens a little shorter than that of the mask
        assert!(
            count > 50 && count.abs_diff(mask[i]) < mask[i] / 8,
            "{count} {}",
            mask[i]
        );
    }
    // scale and shift of the disparity are found by the bounds
    let depth = own("depth");
    for i in 0..5 {
        assert_depth(
            train,
            i,
            &depth[i * W * H..(i + 1) * W * H],
            0.02,
            |_, _| true,
        );
    }
    assert_near(&times(train), &[0.0, 1.0, 2.0, 3.0, 4.0], 0.0);
    assert!(!train.metric && train.duration_s.is_none());

    let test = clip.test.unwrap();
    assert_images(&test, &own("gt"), 0.0, 0.0);
    assert_near(&times(&test), &[0.0, 1.0, 2.0, 3.0, 4.0], 0.0);
    let first = train.frames[0].camera;
    assert!(
        test.frames
            .iter()
            .all(|f| f.camera == first && f.camera_index == Some(0))
    );
}

/// Pixels that move, a frame.
fn truth_mask() -> Vec<usize> {
    let mask = truth("mask");
    mask.chunks_exact(W * H)
        .map(|m| m.iter().filter(|&&v| v > 0.0).count())
        .collect()
}

#[test]
fn nvidia_holds_out_views_of_other_cameras() {
    let (_dir, path) = copied("import/nvidia");
    std::fs::remove_dir_all(path.join("gt")).unwrap();
    let clip = import(&path, SourceFormat::Nvidia, &ImportOptions::default()).unwrap();
    let test = clip.test.unwrap();
    let actual: Vec<(u32, f64)> = test
        .frames
        .iter()
        .map(|f| (f.camera_index.unwrap(), f.t))
        .collect();
    let mut want = Vec::new();
    for t in 0..5u32 {
        want.extend((0..3).filter(|c| *c != t % 3).map(|c| (c, f64::from(t))));
    }
    assert_eq!(actual, want);
    for frame in &test.frames {
        let camera = &clip.train.frames[frame.camera_index.unwrap() as usize].camera;
        assert_eq!(frame.camera, *camera);
    }
    std::fs::remove_dir_all(path.join("mv_images")).unwrap();
    assert!(
        import(&path, SourceFormat::Nvidia, &ImportOptions::default())
            .unwrap()
            .test
            .is_none()
    );
}

#[test]
fn malformed_nvidia_is_rejected_with_file_and_reason() {
    let (_dir, path) = copied("import/nvidia");
    let original = ImportOptions {
        factor: Some(1),
        ..ImportOptions::default()
    };
    says(
        &refused(&path, SourceFormat::Nvidia, &original),
        &["images is missing"],
    );
    std::fs::rename(path.join("gt/v000_t004.png"), path.join("gt/v000_t005.png")).unwrap();
    refuses(&path, SourceFormat::Nvidia, &["v000_t005.png", "time 5"]);
    std::fs::remove_file(path.join("motion_masks/002.png")).unwrap();
    refuses(
        &path,
        SourceFormat::Nvidia,
        &[
            "motion_masks",
            "4 masks (000.png to 004.png) for 5 training frames",
        ],
    );
    std::fs::remove_file(path.join("images_2/002.png")).unwrap();
    refuses(
        &path,
        SourceFormat::Nvidia,
        &[
            "images_2",
            "4 images (000.png to 004.png) for 5 training frames",
        ],
    );
    let mut bytes = std::fs::read(path.join("poses_bounds.npy")).unwrap();
    let focal = bytes.len() - (5 * 17 - 14) * 8;
    bytes[focal..focal + 8].copy_from_slice(&(-50f64).to_le_bytes());
    std::fs::write(path.join("poses_bounds.npy"), &bytes).unwrap();
    refuses(
        &path,
        SourceFormat::Nvidia,
        &["poses_bounds.npy, camera 0", "focal length fx is -50"],
    );
    std::fs::write(path.join("poses_bounds.npy"), &bytes[..bytes.len() - 8]).unwrap();
    refuses(
        &path,
        SourceFormat::Nvidia,
        &["poses_bounds.npy", "damaged or cut off"],
    );
}

#[test]
fn dycheck_matches_the_clip_it_was_written_from() {
    let path = fixture("import/dycheck");
    let heard = Heard::default();
    let clip = read(
        &path,
        SourceFormat::Dycheck,
        &ImportOptions::default(),
        &heard,
    )
    .unwrap();
    assert!(heard.all().contains("thousandths"), "{}", heard.all());
    let train = &clip.train;
    assert_poses(train, "c2w");
    assert_true_lens(train);
    assert_images(train, &truth("rgb"), 0.0, 0.0);
    let depth = truth("depth");
    for i in 0..5 {
        assert_depth(
            train,
            i,
            &depth[i * W * H..(i + 1) * W * H],
            1e-6,
            |x, y| y > 0 || x >= 4,
        );
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
fn dycheck_times_are_those_of_the_splits() {
    let (_dir, path) = copied("import/dycheck");
    std::fs::remove_file(path.join("extra.json")).unwrap();
    // every second frame is held out, and one of another camera is left out
    let put = |split: &str, names: &[&str], cameras: &[u32], times: &[u32]| {
        let split_json =
            serde_json::json!({ "frame_names": names, "camera_ids": cameras, "time_ids": times });
        std::fs::write(
            path.join(format!("splits/{split}.json")),
            split_json.to_string(),
        )
        .unwrap();
    };
    put(
        "train",
        &["0_00000", "0_00002", "0_00004", "1_00001"],
        &[0, 0, 0, 1],
        &[0, 2, 4, 1],
    );
    put(
        "val",
        &["0_00001", "0_00003", "2_00003"],
        &[0, 0, 2],
        &[1, 3, 3],
    );
    let heard = Heard::default();
    let clip = read(
        &path,
        SourceFormat::Dycheck,
        &ImportOptions::default(),
        &heard,
    )
    .unwrap();
    assert!(
        heard.all().contains("30 frames per second"),
        "{}",
        heard.all()
    );
    assert!(
        heard.all().contains("1 of 4 training frames"),
        "{}",
        heard.all()
    );
    assert!((clip.train.duration_s.unwrap() - 4.0 / 30.0).abs() < 1e-12);
    assert_near(&times(&clip.train), &[0.0, 1.0, 2.0], 0.0);
    assert_near(&times(&clip.test.unwrap()), &[0.5, 1.5, 1.5], 1e-12);
}

#[test]
fn depth_unit_fits_the_scene() {
    let depth = |path: &std::path::Path| {
        let clip = import(path, SourceFormat::Dycheck, &ImportOptions::default()).unwrap();
        let depth = clip.train.frames[1].depth.clone().unwrap();
        (
            f64::from(depth.at(20, 20)) / truth("depth")[W * H + 20 * W + 20],
            clip.train.metric,
        )
    };
    let (_dir, path) = copied("import/dycheck");
    // a scene whose places are millimetres too
    edit(
        &path.join("scene.json"),
        r#""near": 0.3, "far": 1.125"#,
        r#""near": 300.0, "far": 1125.0"#,
    );
    let (ratio, metric) = depth(&path);
    assert!((ratio - 1000.0).abs() < 1e-2 && !metric);
    std::fs::remove_file(path.join("scene.json")).unwrap();
    assert!((depth(&path).0 - 1.0).abs() < 1e-5);
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
    let clip = import(&path, SourceFormat::Dycheck, &ImportOptions::default()).unwrap();
    // a barrel lens saw more than a pinhole of its focal length: the pinhole that shows all of it
    // is shorter
    let (k, want) = (clip.train.frames[0].camera.intrinsics, truth("k"));
    assert!(k.fx < want[0] * 0.99 && k.fx > want[0] * 0.9, "{k:?}");
    assert!((k.fx / k.fy - want[0] / want[4]).abs() < 1e-9, "{k:?}");
    let file = path.join("camera/0_00002.json");
    edit(&file, r#""skew": 0.0"#, r#""skew": 0.5"#);
    refuses(
        &path,
        SourceFormat::Dycheck,
        &["0_00002.json", "skew is 0.5"],
    );
}

#[test]
fn malformed_dycheck_is_rejected_with_file_and_reason() {
    let factor = ImportOptions {
        factor: Some(4),
        ..ImportOptions::default()
    };
    says(
        &refused(&fixture("import/dycheck"), SourceFormat::Dycheck, &factor),
        &["rgb/4x is missing", "factor"],
    );
    let broken = |file: &str, from: &str, to: &str, says: &[&str]| {
        let (_dir, path) = copied("import/dycheck");
        edit(&path.join(file), from, to);
        refuses(&path, SourceFormat::Dycheck, says);
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
        &["focal length fx is -1"],
    );
    broken(
        "camera/0_00001.json",
        "[96, 72]",
        "[72, 96]",
        &["0_00001.png", "rotated"],
    );
    let (_dir, path) = copied("import/dycheck");
    std::fs::remove_file(path.join("splits/train.json")).unwrap();
    refuses(
        &path,
        SourceFormat::Dycheck,
        &["splits/train.json is missing"],
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
    broken(
        "splits/val.json",
        "1_00001",
        "../../x",
        &["not the name of a frame"],
    );
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
