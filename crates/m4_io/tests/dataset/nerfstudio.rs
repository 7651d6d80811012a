//! `transforms.json` of nerfstudio, Instant4D and D-NeRF, and our own captures.

use super::truth_a::{SIZE, Truth, beside, read};
use crate::dataset::support::{Heard, copied, fixture, refuses};
use m4_core::Silent;
use m4_io::capture::{Axes, Split};
use m4_io::dataset::SourceFormat::Nerfstudio;
use m4_io::dataset::{ImportOptions, read as import};

#[test]
fn applied_transform_and_scale_are_undone() {
    let truth = Truth::read();
    let got = read("import/nerfstudio", Nerfstudio, &ImportOptions::default()).unwrap();
    // images are JPEG
    truth.same_cameras(&got.train, (12, 2.0));
    // millimetres
    truth.same_depth(&got.train, 0.0, 0.000_501);
    truth.same_masks(&got.train);
    assert_eq!(got.train.frames[4].name, "images/frame_5.jpg");
    assert_eq!(got.train.frames[4].t, 4.0);
}

#[test]
fn mask_and_depth_options_are_applied() {
    let truth = Truth::read();
    let options =
        ImportOptions { invert_masks: true, depth_unit: Some(0.002), fps: Some(8.0), ..ImportOptions::default() };
    let got = read("import/nerfstudio", Nerfstudio, &options).unwrap().train;
    let mask = got.frames[0].mask.as_ref().unwrap();
    assert_eq!(mask.count(), SIZE.0 * SIZE.1 - 80);
    let z = f64::from(got.frames[1].depth.as_ref().unwrap().at(20, 20));
    assert!((z - 2.0 * truth.depth[1][20 * SIZE.0 + 20]).abs() < 0.0011);
    assert_eq!(got.duration_s, Some(0.5));
}

#[test]
fn axes_by_keys_or_by_the_option() {
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
    let turned = ImportOptions { axes: Some(Axes::OpenGl), ..beside() };
    let got = import(&path, Nerfstudio, &turned, &Silent).unwrap().train;
    let (a, b) = (got.frames[0].camera.c2w.rotation, truth.c2w[0].rotation);
    assert!((a.column(2) + b.column(2)).amax() < 1e-9 && (a.column(0) - b.column(0)).amax() < 1e-9);
}

#[test]
fn nerfstudio_training_and_test_splits_are_read() {
    let truth = Truth::read();
    let got = read("import/blender", Nerfstudio, &beside()).unwrap();
    let test = got.test.unwrap();
    assert_eq!((got.train.frames.len(), got.train.time_frames, test.frames.len()), (3, 3, 2));
    for (frames, indices) in [(&got.train.frames, &[0, 2, 4][..]), (&test.frames, &[1, 3][..])] {
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
    let mut capture = read("import/nerfstudio", Nerfstudio, &ImportOptions::default()).unwrap().train;
    capture.duration_s = Some(0.75);
    capture.metric = true;
    let dir = tempfile::tempdir().unwrap();
    m4_io::capture::write(dir.path(), &capture, Split::Train, &Silent).unwrap();
    let got = import(dir.path(), Nerfstudio, &ImportOptions::default(), &Silent).unwrap().train;
    truth.same_cameras(&got, (12, 2.0));
    truth.same_masks(&got);
    assert_eq!((got.metric, got.duration_s), (true, Some(0.75)));
    for (a, b) in got.frames.iter().zip(&capture.frames) {
        assert_eq!(a.rgb, b.rgb);
        for (a, b) in a.depth.as_ref().unwrap().every(1).zip(b.depth.as_ref().unwrap().every(1)) {
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
    let lists =
        format!("{{\"train_filenames\": [{}, {}, {}], \"test_filenames\": [{}], ", name(1), name(3), name(5), name(2));
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
    check("\"fl_x\"", "\"fl\"", &["fl_x", "frame_1.jpg"]);
    check("\"OPENCV\"", "\"EQUIRECTANGULAR\"", &["EQUIRECTANGULAR", "OPENCV_FISHEYE"]);
    check("\"p2\": 0.0", "\"k4\": 0.5", &["k4 = 0.5"]);
    check("\"w\": 48", "\"w\": 96", &["w = 96", "48"]);
    check("\"applied_scale\": 0.5", "\"applied_scale\": 0", &["applied_scale"]);
    check("images/frame_3.jpg", "images/frame_9.jpg", &["frame_9.jpg", "frame 2"]);
    check("\"transform_matrix\": [[", "\"transform_matrix\": [[9", &["transform_matrix", "rotation"]);
    check("\"transform_matrix\"", "\"time\": 0.5, \"transform_matrix\"", &["1 of 5 frames have a time"]);
    check("{\"w\": 48", "{\"w\": NaN", &["NaN"]);
}
