//! Trajectories of the TUM and KITTI benchmarks, as evo 1.38 writes them.

use super::truth::{Truth, read, with_pictures};
use crate::support::{copied, fixture, refused};
use m4_import::ImportOptions;
use m4_import::SourceFormat::{Kitti, Tum};

#[test]
fn a_sequence_of_tum() {
    let truth = Truth::read();
    let got = read("import/tum", Tum, &ImportOptions::default()).unwrap().train;
    truth.same_cameras(&got, (0, 0.0));
    truth.same_depth(&got, 0.0, 0.000_101);
    assert!(got.metric && (got.duration_s.unwrap() - 0.5).abs() < 1e-5);
    let times: Vec<f64> = got.frames.iter().map(|f| f.t).collect();
    for (t, want) in times.iter().zip([0.0, 0.8, 1.6, 2.4, 4.0]) {
        assert!((t - want).abs() < 1e-5, "{times:?}");
    }
}

#[test]
fn poses_that_name_their_pictures() {
    let truth = Truth::read();
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("track.txt");
    let text = std::fs::read_to_string(fixture("import/tum/groundtruth.txt")).unwrap();
    let rest: Vec<&str> = text
        .lines()
        .filter_map(|l| l.split_once(' '))
        .map(|(_, rest)| rest)
        .collect();
    // the third and the sixth are of poses that no picture is nearest to
    std::fs::write(
        &file,
        format!("# t x y z q\n0 {}\n2.0 {}\n4 {}\n", rest[0], rest[3], rest[6]),
    )
    .unwrap();
    let message = refused(&file, Tum, &with_pictures());
    assert!(
        message.contains("intrinsics.txt") && message.contains("focal_px"),
        "{message}"
    );
    let options = ImportOptions {
        focal_px: Some(51.0),
        ..with_pictures()
    };
    let got = m4_import::read(&file, Tum, &options, &m4_scene::Silent).unwrap().train;
    assert_eq!((got.frames.len(), got.time_frames, got.metric), (3, 5, false));
    for (frame, i) in got.frames.iter().zip([0, 2, 4]) {
        truth.same_pose(i, frame);
        truth.same_picture(i, &frame.rgb, (0, 0.0));
        assert_eq!(frame.t, i as f64);
        let k = frame.camera.intrinsics;
        assert_eq!([k.fx, k.fy, k.cx, k.cy], [51.0, 51.0, 24.0, 18.0]);
    }
    // as many seconds as pictures, else an error
    let stamped: String = rest
        .iter()
        .enumerate()
        .map(|(i, r)| format!("{} {r}\n", 0.5 + 0.1 * i as f64))
        .collect();
    std::fs::write(&file, stamped).unwrap();
    let message = refused(&file, Tum, &options);
    assert!(
        message.contains("7 poses") && message.contains("5 pictures"),
        "{message}"
    );
    let message = refused(&file, Tum, &ImportOptions::default());
    assert!(message.contains("pictures"), "{message}");
}

#[test]
fn a_sequence_of_kitti() {
    let truth = Truth::read();
    for name in ["import/kitti", "import/kitti/poses.txt"] {
        let got = read(name, Kitti, &ImportOptions::default()).unwrap().train;
        truth.same_cameras(&got, (0, 0.0));
        assert!(got.metric && (got.duration_s.unwrap() - 0.4).abs() < 1e-6);
    }
    let (_dir, here) = copied("import/kitti");
    std::fs::remove_file(here.join("calib.txt")).unwrap();
    let message = refused(&here, Kitti, &ImportOptions::default());
    assert!(
        message.contains("calib.txt") && message.contains("intrinsics.txt"),
        "{message}"
    );
    // with a lens beside it, poses are of the camera that took the pictures
    std::fs::write(here.join("intrinsics.txt"), "50 52 23.5 18.75\n-0.2 0.05 0 0\n").unwrap();
    let got = m4_import::read(&here, Kitti, &ImportOptions::default(), &m4_scene::Silent)
        .unwrap()
        .train;
    let k = got.frames[0].camera.intrinsics;
    assert!(k.fx < 49.5 && [k.cx, k.cy] == [23.5, 18.75], "{k:?}");
    assert!(!got.metric);
    std::fs::write(here.join("intrinsics.txt"), "50 52 23.5 18.75 1\n").unwrap();
    let message = refused(&here, Kitti, &ImportOptions::default());
    assert!(message.contains("5 numbers"), "{message}");
}
