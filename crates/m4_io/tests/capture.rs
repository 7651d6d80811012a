//! Captures: what is written comes back, and the benchmark scenes are read as they are meant.

use crate::common::Heard;
use m4_core::{
    Camera, Capture, CaptureFrame, CompactIds, CompactMask, Intrinsics, Plane, Se3, Silent, nalgebra::Vector6,
};
use m4_io::capture::{CaptureOptions, Split, read, write};
use std::path::PathBuf;

#[track_caller]
fn bench(name: &str) -> Option<PathBuf> {
    m4_testkit::shared(&format!("bench/{name}"))
}

fn made(frames: usize) -> Capture {
    let pose = |i: usize| {
        let a = i as f64 * 0.1;
        Se3::identity().retract(&Vector6::new(a, -0.3, 2.0 + a, 0.2 * a, 0.7, -a))
    };
    let frame = |i: usize| CaptureFrame {
        name: format!("frame {i}"),
        camera: Camera {
            intrinsics: Intrinsics { width: 24, height: 18, fx: 31.25 + i as f64 / 3.0, fy: 30.1, cx: 11.7, cy: 9.3 },
            c2w: pose(i),
        },
        t: i as f64,
        rgb: Plane::from_fn(24, 18, |x, y| [x as u8 * 9, y as u8 * 13, i as u8]),
        depth: (i != 1)
            .then(|| Plane::from_fn(12, 9, |x, y| if x == 0 { 0.0 } else { 1.0 + (x * y) as f32 / 7.0 }).into()),
        mask: (i != 2).then(|| CompactMask::from_fn(24, 18, |x, y| x * y > 99)),
        motion: (i != 3).then(|| Plane::from_fn(6, 5, |x, y| (40 * x + y) as u8)),
        instances: (i != 4)
            .then(|| CompactIds::from(&Plane::from_fn(12, 9, |x, y| u16::from(x > 3) * (y as u16 / 4) * 200))),
        camera_index: None,
    };
    Capture {
        frames: (0..frames).map(frame).collect(),
        time_frames: frames,
        duration_s: Some(1.25),
        metric: true,
        tracks: None,
    }
}

#[test]
fn captures_round_trip() {
    let dir = tempfile::tempdir().unwrap();
    let capture = made(5);
    write(dir.path(), &capture, Split::Train, &Silent).unwrap();
    let got = read(dir.path(), Split::Train, &CaptureOptions::default(), &Silent).unwrap();
    assert_eq!((got.time_frames, got.duration_s, got.metric), (5, Some(1.25), true));
    for (got, want) in got.frames.iter().zip(&capture.frames) {
        assert_eq!(got.camera, want.camera);
        assert_eq!((&got.rgb, &got.mask), (&want.rgb, &want.mask));
        assert_eq!((&got.motion, &got.instances), (&want.motion, &want.instances));
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
    write(dir.path(), &made(3), Split::Train, &Silent).unwrap();
    let file = dir.path().join("transforms_train.json");
    assert_eq!(read(&file, Split::Train, &CaptureOptions::default(), &Silent).unwrap().frames.len(), 3);
}

#[test]
fn test_views_are_timed_by_the_training_split() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &made(5), Split::Train, &Silent).unwrap();
    let mut test = made(2);
    test.time_frames = 5;
    test.frames[0].camera_index = Some(0);
    test.frames[1].camera_index = Some(1);
    test.frames[1].t = 2.5;
    write(dir.path(), &test, Split::Test, &Silent).unwrap();
    let got = read(dir.path(), Split::Test, &CaptureOptions::default(), &Silent).unwrap();
    assert_eq!(got.time_frames, 5);
    assert_eq!(got.frames.iter().map(|f| f.t).collect::<Vec<_>>(), [0.0, 2.5]);
    assert_eq!(got.frames.iter().map(|f| f.camera_index).collect::<Vec<_>>(), [Some(0), Some(1)]);
}

#[test]
fn a_nerfstudio_file_without_times_or_centre_is_read_with_a_warning() {
    let dir = tempfile::tempdir().unwrap();
    for i in 0..3 {
        let path = dir.path().join(format!("images/frame_{i}.png"));
        m4_io::image::write_rgb(&path, &Plane::filled(40, 30, [i; 3])).unwrap();
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
    std::fs::write(dir.path().join("transforms.json"), text).unwrap();
    let heard = Heard::default();
    let got = read(dir.path(), Split::Train, &CaptureOptions::default(), &heard).unwrap();
    assert_eq!(got.frames.iter().map(|f| f.t).collect::<Vec<_>>(), [0.0, 1.0, 2.0]);
    let k = got.frames[0].camera.intrinsics;
    assert_eq!((k.fx, k.fy, k.cx, k.cy, k.width, k.height), (50.0, 50.0, 20.0, 15.0, 40, 30));
    // OpenGL looks along -z.
    assert_eq!(got.frames[0].camera.unproject(19.5, 14.5, 2.0).as_slice(), [0.0, 0.0, -2.0]);
    assert!(heard.all().contains("3 frames of") && !heard.all().contains('\n'), "{}", heard.all());
}

#[test]
fn depth_of_the_bench_scenes_agrees_between_frames() {
    let Some(folder) = bench("mill-1") else { return };
    let capture = read(&folder, Split::Train, &CaptureOptions::default(), &Silent).unwrap();
    assert_eq!((capture.frames.len(), capture.time_frames), (96, 96));
    assert!(capture.frames.windows(2).all(|f| f[0].t < f[1].t));
    // A static surface point seen in frame 10 lands at its own depth in frame 14.
    let (a, b) = (&capture.frames[10], &capture.frames[14]);
    let (depth_a, depth_b) = (a.depth.as_ref().unwrap(), b.depth.as_ref().unwrap());
    let (mut seen, mut agree) = (0, 0);
    for y in (0..360).step_by(7) {
        for x in (0..480).step_by(7) {
            let z = f64::from(depth_a.at(x, y));
            if z == 0.0 || a.mask.as_ref().unwrap().at(x, y) {
                continue;
            }
            let (p, want) = b.camera.project(&a.camera.unproject(x as f64, y as f64, z));
            let (u, v) = (p[0].round(), p[1].round());
            if (0.0..480.0).contains(&u) && (0.0..360.0).contains(&v) {
                seen += 1;
                agree += usize::from((f64::from(depth_b.at(u as usize, v as usize)) - want).abs() < 0.02 * want);
            }
        }
    }
    assert!(seen > 1000 && agree * 10 > seen * 9, "{agree} of {seen}");

    let test = read(&folder, Split::Test, &CaptureOptions::default(), &Silent).unwrap();
    assert_eq!(test.time_frames, 96);
    assert!(test.frames.iter().all(|f| f.camera_index.is_some_and(|c| c < 2) && f.depth.is_none()));
    assert!(test.frames.iter().all(|f| (0.0..=95.0).contains(&f.t)));
}
