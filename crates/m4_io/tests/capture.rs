//! Captures: what is written comes back, and captures with faults or that name
//! files outside of their folder are refused.

use crate::common::says;
use m4_core::advice::OUTSIDE;
use m4_core::nalgebra::Vector6;
use m4_core::{
    Camera, Capture, CaptureFrame, CompactIds, CompactMask, Intrinsics, Plane, Se3, Silent, Tracks,
};
use m4_io::capture::{CaptureOptions, Split, as_read, read, write};
use m4_io::image::{write_mask, write_rgb};
use m4_io::reach::Reach;
use m4_io::{ErrorKind, ReadError};
use m4_testkit::Heard;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

fn test_capture(frames: usize) -> Capture {
    let pose = |i: usize| {
        let a = i as f64 * 0.1;
        Se3::identity().retract(&Vector6::new(a, -0.3, 2.0 + a, 0.2 * a, 0.7, -a))
    };
    let frame = |i: usize| CaptureFrame {
        name: format!("frame {i}"),
        camera: Camera {
            intrinsics: Intrinsics {
                width: 24,
                height: 18,
                fx: 31.25 + i as f64 / 3.0,
                fy: 30.1,
                cx: 11.7,
                cy: 9.3,
            },
            c2w: pose(i),
        },
        t: i as f64,
        rgb: Plane::from_fn(24, 18, |x, y| [x as u8 * 9, y as u8 * 13, i as u8]),
        depth: (i != 1).then(|| {
            Plane::from_fn(12, 9, |x, y| {
                if x == 0 {
                    0.0
                } else {
                    1.0 + (x * y) as f32 / 7.0
                }
            })
            .into()
        }),
        mask: (i != 2).then(|| CompactMask::from_fn(24, 18, |x, y| x * y > 99)),
        motion: (i != 3).then(|| Plane::from_fn(6, 5, |x, y| (40 * x + y) as u8)),
        instances: (i != 4).then(|| {
            CompactIds::from(&Plane::from_fn(12, 9, |x, y| {
                u16::from(x > 3) * (y as u16 / 4) * 200
            }))
        }),
        camera_index: None,
        distance_sigma: (i > 0).then_some(0.03 * i as f32),
    };
    Capture {
        frames: (0..frames).map(frame).collect(),
        time_frames: frames,
        duration_s: Some(1.25),
        metric: true,
        tracks: None,
    }
}

/// Reads the training frames.
fn train(path: &Path) -> Result<Capture, ReadError> {
    read(path, Split::Train, &CaptureOptions::default(), &Silent)
}

#[test]
fn captures_round_trip() {
    let dir = tempfile::tempdir().unwrap();
    let capture = test_capture(5);
    write(dir.path(), &capture, Split::Train, &Silent).unwrap();
    let got = train(dir.path()).unwrap();
    assert_eq!(
        (got.time_frames, got.duration_s, got.metric),
        (5, Some(1.25), true)
    );
    for (got, want) in got.frames.iter().zip(&capture.frames) {
        assert_eq!(got.camera, want.camera);
        assert_eq!((&got.rgb, &got.mask), (&want.rgb, &want.mask));
        assert_eq!(
            (&got.motion, &got.instances),
            (&want.motion, &want.instances)
        );
        assert_eq!(got.distance_sigma, want.distance_sigma);
        assert!((got.t - want.t).abs() < 1e-12);
        match (&got.depth, &want.depth) {
            (Some(got), Some(want)) => {
                assert_eq!((got.size(), got.bytes()), (want.size(), 2 * 12 * 9));
                for (g, w) in got.every(1).zip(want.every(1)) {
                    assert!((g - w).abs() <= 0.0025 * w, "{g} {w}");
                    assert_eq!(g == 0.0, w == 0.0);
                }
            }
            (got, want) => assert_eq!(got.is_some(), want.is_some()),
        }
    }
    // Again over the same folder, with fewer frames.
    write(dir.path(), &test_capture(3), Split::Train, &Silent).unwrap();
    let file = dir.path().join("transforms_train.json");
    assert_eq!(train(&file).unwrap().frames.len(), 3);
}

#[test]
fn a_deviation_out_of_range_is_refused_with_its_place() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &test_capture(3), Split::Train, &Silent).unwrap();
    let list = dir.path().join("transforms_train.json");
    let text = fs::read_to_string(&list).unwrap();
    let changed = text.replace("\"distance_sigma\": 0.06", "\"distance_sigma\": -0.06");
    assert_ne!(changed, text);
    fs::write(&list, changed).unwrap();
    let error = train(dir.path()).unwrap_err().to_string();
    assert!(
        error.contains("frame 2") && error.contains("distance_sigma is -0.0"),
        "{error}"
    );
}

#[test]
fn a_capture_in_memory_is_the_one_that_is_read() {
    let dir = tempfile::tempdir().unwrap();
    // Every third frame of a longer video, with depths that 16 bits round or clip.
    let places = (0..10).map(|i| [i as f32 / 3.0, 1.0 / 7.0, f32::NAN]);
    let tracks = Tracks::new(5, 2, places.collect(), vec![true; 10]).unwrap();
    let mut capture = Capture {
        time_frames: 14,
        tracks: Some(tracks.with_confidence(&[0.4; 10]).unwrap()),
        ..test_capture(5)
    };
    for (i, frame) in capture.frames.iter_mut().enumerate() {
        frame.t = 3.0 * i as f64 + 0.1;
    }
    capture.frames[0].depth = Some(Plane::from_fn(9, 7, |x, _| 1e-3 * 9f32.powi(x as i32)).into());
    write(dir.path(), &capture, Split::Train, &Silent).unwrap();
    let options = CaptureOptions::default();
    let read = read(dir.path(), Split::Train, &options, &Silent).unwrap();
    let held = as_read(dir.path(), capture.clone(), &options, &Silent).unwrap();
    assert_eq!(
        (held.time_frames, held.duration_s, held.metric),
        (5, read.duration_s, read.metric)
    );
    // A place that is NaN is equal to nothing.
    assert_eq!(format!("{:?}", held.tracks), format!("{:?}", read.tracks));
    for (held, read) in held.frames.iter().zip(&read.frames) {
        assert_eq!(
            (&held.name, held.camera, held.t.to_bits()),
            (&read.name, read.camera, read.t.to_bits())
        );
        assert_eq!((&held.rgb, &held.mask), (&read.rgb, &read.mask));
        assert_eq!(
            (&held.motion, &held.instances),
            (&read.motion, &read.instances)
        );
        assert_eq!(held.camera_index, read.camera_index);
        assert_eq!(held.distance_sigma, read.distance_sigma);
        assert_eq!(format!("{:?}", held.depth), format!("{:?}", read.depth));
    }
    let little = CaptureOptions {
        max_memory_bytes: 1000,
        ..options
    };
    let [of_files, of_memory] = [
        m4_io::capture::read(dir.path(), Split::Train, &little, &Silent),
        as_read(dir.path(), capture, &little, &Silent),
    ];
    assert_eq!(
        of_memory.unwrap_err().to_string(),
        of_files.unwrap_err().to_string()
    );
}

#[test]
fn a_capture_whose_replacement_was_interrupted_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let next = dir.path().join(".minute4d-capture-done");
    write(&next, &test_capture(5), Split::Train, &Silent).unwrap();
    let got = train(dir.path()).unwrap();
    assert_eq!(got.frames.len(), 5);
    assert!(!next.exists() && dir.path().join("transforms_train.json").is_file());
}

#[test]
fn test_views_are_timed_by_the_training_split() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &test_capture(5), Split::Train, &Silent).unwrap();
    let mut test = test_capture(2);
    test.time_frames = 5;
    test.frames[0].camera_index = Some(0);
    test.frames[1].camera_index = Some(1);
    test.frames[1].t = 2.5;
    write(dir.path(), &test, Split::Test, &Silent).unwrap();
    let got = read(dir.path(), Split::Test, &CaptureOptions::default(), &Silent).unwrap();
    assert_eq!(got.time_frames, 5);
    assert_eq!(
        got.frames.iter().map(|f| f.t).collect::<Vec<_>>(),
        [0.0, 2.5]
    );
    assert_eq!(
        got.frames
            .iter()
            .map(|f| f.camera_index)
            .collect::<Vec<_>>(),
        [Some(0), Some(1)]
    );
}

#[test]
fn a_nerfstudio_file_without_times_or_centre_is_read_with_a_warning() {
    let dir = tempfile::tempdir().unwrap();
    for i in 0..3 {
        let path = dir.path().join(format!("images/frame_{i}.png"));
        write_rgb(&path, &Plane::filled(40, 30, [i; 3])).unwrap();
    }
    let frame = |i: usize| {
        format!(
            r#"{{"file_path": "images/frame_{i}{}", "colmap_im_id": {i}, "w": 40,
                "transform_matrix": [[1,0,0,{i}],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}"#,
            if i == 1 { "" } else { ".png" }
        )
    };
    let text = format!(
        r#"{{"fl_x": 50.0, "h": 30.0, "applied_transform": [[1,0,0,0],[0,1,0,0],[0,0,1,0]], "frames": [{}, {}, {}]}}"#,
        frame(0),
        frame(1),
        frame(2)
    );
    fs::write(dir.path().join("transforms.json"), text).unwrap();
    let heard = Heard::default();
    let got = read(dir.path(), Split::Train, &CaptureOptions::default(), &heard).unwrap();
    assert_eq!(
        got.frames.iter().map(|f| f.t).collect::<Vec<_>>(),
        [0.0, 1.0, 2.0]
    );
    let k = got.frames[0].camera.intrinsics;
    assert_eq!(
        (k.fx, k.fy, k.cx, k.cy, k.width, k.height),
        (50.0, 50.0, 20.0, 15.0, 40, 30)
    );
    // OpenGL looks along -z.
    assert_eq!(
        got.frames[0].camera.unproject(19.5, 14.5, 2.0).as_slice(),
        [0.0, 0.0, -2.0]
    );
    assert!(
        heard.all().contains("3 frames of") && !heard.all().contains('\n'),
        "{}",
        heard.all()
    );
}

/// A capture of two frames, as JSON to spoil.
fn good() -> (TempDir, Value) {
    let dir = tempfile::tempdir().unwrap();
    for i in 0..2 {
        write_rgb(
            &dir.path().join(format!("{i}.png")),
            &Plane::filled(20, 10, [i; 3]),
        )
        .unwrap();
    }
    let frame = |i: i32| {
        json!({"file_path": format!("{i}.png"), "time": i,
               "transform_matrix": [[1, 0, 0, i], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]})
    };
    (
        dir,
        json!({"fl_x": 30.0, "w": 20, "h": 10, "frames": [frame(0), frame(1)]}),
    )
}

#[test]
fn one_moment_and_repeated_images_are_reported() {
    let said = |spoil: &dyn Fn(&mut Value)| {
        let (dir, mut json) = good();
        spoil(&mut json);
        fs::write(dir.path().join("transforms_train.json"), json.to_string()).unwrap();
        let heard = Heard::default();
        read(dir.path(), Split::Train, &CaptureOptions::default(), &heard).unwrap();
        heard.all()
    };
    assert_eq!(said(&|_| {}), "");
    let moment = said(&|json| json["frames"][1]["time"] = json!(0));
    assert!(
        moment.contains("all 2 frames of") && moment.contains("the time 0"),
        "{moment}"
    );
    let twice = said(&|json| json["frames"][1]["file_path"] = json!("0.png"));
    assert!(
        twice.contains("lists the image 0.png 2 times, 1 images for 2 frames"),
        "{twice}"
    );
}

#[test]
fn byte_order_marks_are_read_or_named() {
    let (dir, json) = good();
    let list = dir.path().join("transforms_train.json");
    let text = json.to_string();
    let read = || train(dir.path());
    fs::write(&list, format!("\u{feff}{text}")).unwrap();
    assert_eq!(read().unwrap().frames.len(), 2);
    let wide: Vec<u8> = [0xfeff]
        .into_iter()
        .chain(text.encode_utf16())
        .flat_map(u16::to_le_bytes)
        .collect();
    fs::write(&list, wide).unwrap();
    says(
        &read().unwrap_err(),
        &[
            "transforms_train.json",
            "UTF-16",
            "byte order mark",
            "UTF-8",
        ],
    );
}

type Spoil = fn(&mut Value);

#[test]
fn faults_of_frames_and_keys_are_named() {
    use ErrorKind::{BadData, NotFound, Unsupported};
    let cases: [(Spoil, ErrorKind, &[&str]); 26] = [
        (
            |j| {
                drop(
                    j["frames"][1]
                        .as_object_mut()
                        .unwrap()
                        .remove("transform_matrix"),
                )
            },
            BadData,
            &["frame 1", "1.png", "transform_matrix is missing"],
        ),
        (
            |j| j["frames"][1]["transform_matrix"][0][0] = json!(-1),
            BadData,
            &["frame 1", "determinant -1.0"],
        ),
        (
            |j| j["frames"][0]["transform_matrix"][0][0] = json!(1.5),
            BadData,
            &["frame 0", "determinant 1.5"],
        ),
        (
            |j| {
                drop(
                    j["frames"][0]["transform_matrix"]
                        .as_array_mut()
                        .unwrap()
                        .drain(1..),
                )
            },
            BadData,
            &["frame 0", "1 rows of 4", "4 rows of 4"],
        ),
        (
            |j| j["frames"][1]["transform_matrix"][2][1] = json!(null),
            BadData,
            &["frame 1", "null"],
        ),
        (
            |j| j["frames"][1]["transform_matrix"][3] = json!([4, 5, 6, 1]),
            BadData,
            &["frame 1", "[4.0, 5.0, 6.0, 1.0]", "transposed"],
        ),
        (
            |j| j["fl_x"] = json!(-5.0),
            BadData,
            &["frame 0", "fl_x is -5; 0.2 to 20000 pixels"],
        ),
        (
            |j| j["fl_x"] = json!(1e-30),
            BadData,
            &["frame 0", "fl_x is 1e-30"],
        ),
        (
            |j| j["frames"][1]["transform_matrix"][0][3] = json!(1e39),
            BadData,
            &[
                "frame 1",
                "transform_matrix: its translation holds 1e39; -1e7 to 1e7 scene units",
            ],
        ),
        (
            |j| j["depth_unit_scale_factor"] = json!(1e30),
            BadData,
            &["depth_unit_scale_factor", "1e30; 1e-9 to 152"],
        ),
        (
            |j| j["applied_scale"] = json!(1e-39),
            BadData,
            &["applied_scale", "1e-39; 1e-9 to 1e9"],
        ),
        (
            |j| j["duration_s"] = json!(1e30),
            BadData,
            &["duration_s", "1e30; 0 to 1e9 seconds"],
        ),
        (
            |j| j["duration_s"] = json!(1e-30),
            BadData,
            &["frame rate", "1e-6 to 1000000 frames per second"],
        ),
        (
            |j| drop(j.as_object_mut().unwrap().remove("fl_x")),
            BadData,
            &["frame 0", "fl_x", "missing"],
        ),
        (
            |j| j["cx"] = json!(900.0),
            BadData,
            &["the principal point cx is 900; -20 to 40 pixels"],
        ),
        (|j| j["camera_model"] = json!("FOV"), Unsupported, &["FOV"]),
        (
            |j| j["depth_unit_scale_factor"] = json!(0),
            BadData,
            &["depth_unit_scale_factor", "it is 0"],
        ),
        (
            |j| j["duration_s"] = json!(-1),
            BadData,
            &["duration_s", "it is -1"],
        ),
        (|j| j["frames"] = json!([]), BadData, &["no frames"]),
        (
            |j| j["frames"][1]["time"] = json!(1.5),
            BadData,
            &["frame 1", "time = 1.5", "0 (first"],
        ),
        (
            |j| j["frames"][1]["time"] = json!("soon"),
            BadData,
            &["frame 1", "soon"],
        ),
        (
            |j| drop(j["frames"][1].as_object_mut().unwrap().remove("time")),
            BadData,
            &["1 of 2 frames have a time"],
        ),
        (
            |j| j["frames"][0]["file_path"] = json!("gone.png"),
            NotFound,
            &["frame 0", "gone.png"],
        ),
        (
            |j| j["w"] = json!(40),
            BadData,
            &["0.png", "w = 40", "has 20"],
        ),
        (
            |j| j["frames"][1]["depth_file_path"] = json!("0.png"),
            BadData,
            &["frame 1", "0.png", "16 bits"],
        ),
        (
            |j| j["frames"][1]["mask_path"] = json!("mask/1.png"),
            NotFound,
            &["frame 1", "1.png"],
        ),
    ];
    let (dir, json) = good();
    assert_eq!(
        read_json(dir.path(), &json, Reach::Inside)
            .unwrap()
            .frames
            .len(),
        2
    );
    for (spoil, kind, words) in cases {
        let mut spoilt = json.clone();
        spoil(&mut spoilt);
        let error = read_json(dir.path(), &spoilt, Reach::Inside).unwrap_err();
        assert_eq!(error.kind(), kind, "{error}");
        says(&error, &[&["transforms_train.json"], words].concat());
    }
}

#[test]
fn malformed_or_missing_lists_of_frames_are_refused() {
    let (dir, json) = good();
    let path = dir.path().join("transforms_train.json");
    fs::write(&path, json.to_string().replace("30.0", "NaN")).unwrap();
    let failed = || train(&path).unwrap_err();
    says(&failed(), &["line 1", "neither NaN nor Infinity"]);
    fs::write(&path, &json.to_string()[..200]).unwrap();
    says(&failed(), &["not the JSON that was expected", "EOF"]);
    fs::remove_file(&path).unwrap();
    let error = train(dir.path()).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::NotFound);
    says(&error, &["transforms_train.json", "a capture is a folder"]);
}

#[test]
fn test_views_without_a_training_split() {
    let (dir, json) = good();
    fs::write(dir.path().join("transforms_test.json"), json.to_string()).unwrap();
    let error = read(dir.path(), Split::Test, &CaptureOptions::default(), &Silent).unwrap_err();
    says(
        &error,
        &[
            "transforms_test.json",
            "transforms_train.json",
            "time_frames",
        ],
    );
}

#[test]
fn a_capture_that_does_not_fit_in_memory() {
    let (dir, json) = good();
    fs::write(dir.path().join("transforms_train.json"), json.to_string()).unwrap();
    let small = CaptureOptions {
        max_memory_bytes: 1000,
        ..CaptureOptions::default()
    };
    let error = read(dir.path(), Split::Train, &small, &Silent).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsupported);
    says(&error, &["2 frames", "max_memory_bytes"]);
}

fn read_json(folder: &Path, json: &Value, reach: Reach) -> Result<Capture, ReadError> {
    fs::write(folder.join("transforms_train.json"), json.to_string()).unwrap();
    let options = CaptureOptions {
        reach,
        ..CaptureOptions::default()
    };
    read(folder, Split::Train, &options, &Silent)
}

/// It is refused by a message that names the list, the place, the file and the way out.
fn refused(folder: &Path, json: &Value, words: &[&str]) {
    let error = read_json(folder, json, Reach::Inside).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::BadData, "{error}");
    says(
        &error,
        &[&["transforms_train.json", "outside of", OUTSIDE], words].concat(),
    );
}

#[test]
fn files_outside_the_capture_are_not_read() {
    let (dir, json) = good();
    let folder = dir.path().join("set");
    fs::create_dir(&folder).unwrap();
    for i in 0..2 {
        fs::rename(
            dir.path().join(format!("{i}.png")),
            folder.join(format!("{i}.png")),
        )
        .unwrap();
    }
    let private = dir.path().join("private.png");
    write_rgb(&private, &Plane::filled(20, 10, [77; 3])).unwrap();
    write_mask(&dir.path().join("mask.png"), &Plane::filled(20, 10, 255)).unwrap();
    read_json(&folder, &json, Reach::Inside).unwrap();

    let original = private.display().to_string();
    for name in [
        "../private.png",
        "../private",
        "../set/../private.png",
        original.as_str(),
    ] {
        let mut json = json.clone();
        json["frames"][1]["file_path"] = json!(name);
        refused(&folder, &json, &["frame 1", "private.png"]);
        let got = read_json(&folder, &json, Reach::Anywhere).unwrap();
        assert_eq!(got.frames[1].rgb[(0, 0)], [77; 3]);
    }
    for key in [
        "depth_file_path",
        "mask_path",
        "motion_path",
        "instance_path",
    ] {
        let mut json = json.clone();
        json["frames"][0][key] = json!("../mask.png");
        refused(&folder, &json, &["frame 0", "mask.png"]);
    }
    let mut with_tracks = json.clone();
    with_tracks["tracks_path"] = json!("../mask.png");
    refused(&folder, &with_tracks, &["tracks_path", "mask.png"]);
}

#[test]
fn permission_to_read_outside_is_not_serialised() {
    let anywhere = CaptureOptions {
        reach: Reach::Anywhere,
        ..CaptureOptions::default()
    };
    let text = serde_json::to_string(&anywhere).unwrap();
    assert!(!text.contains("reach"), "{text}");
    let again: CaptureOptions = serde_json::from_str(&text).unwrap();
    assert_eq!(again.reach, Reach::Inside);
    assert!(serde_json::from_str::<CaptureOptions>(r#"{"reach": "Anywhere"}"#).is_err());
}
