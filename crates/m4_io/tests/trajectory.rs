//! Camera paths of every layout, against numbers worked out by hand.

use crate::common::{says, temporary};
use m4_core::Camera;
use m4_core::nalgebra::{Matrix3, Vector3};
use m4_io::trajectory::{self, KeyPose, Keyed, SceneTime, Trajectory};
use m4_io::{ErrorKind, ReadError};

fn load(text: &str) -> Result<Trajectory, ReadError> {
    let (_dir, path) = temporary("path.json");
    std::fs::write(&path, text).unwrap();
    trajectory::load(&path, 11)
}

fn listed(text: &str) -> Vec<(Camera, f64)> {
    match load(text).unwrap() {
        Trajectory::Listed(listed) => listed,
        Trajectory::Keyed(_) => panic!("keyframes"),
    }
}

fn keyed(text: &str) -> Keyed {
    match load(text).unwrap() {
        Trajectory::Keyed(keyed) => keyed,
        Trajectory::Listed(_) => panic!("a list"),
    }
}

fn refused(text: &str, words: &[&str]) {
    let error = load(text).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::BadData);
    says(&error, &[&["path.json"], words].concat());
}

fn matrix(pose: &KeyPose) -> (Matrix3<f64>, Vector3<f64>) {
    match pose {
        KeyPose::C2w(c2w) => (c2w.rotation, c2w.translation),
        KeyPose::LookAt { .. } => panic!("no matrix"),
    }
}

#[test]
fn cameras_of_transforms_are_listed() {
    let got = listed(
        r#"{"fl_x": 30, "w": 20, "h": 10, "axes": "opencv", "frames": [
        {"transform_matrix": [[1,0,0,3],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "time": 1.0}]}"#,
    );
    assert_eq!(got[0].1, 10.0);
    assert!((got[0].0.unproject(9.5, 4.5, 2.0) - Vector3::new(3.0, 0.0, 2.0)).norm() < 1e-12);
    // OpenGL, evenly spaced; the second: right is y, up is z, back is x, so it looks along -x with
    // -z downwards
    let got = listed(
        r#"{"camera_angle_x": 1.5707963267948966, "w": 200, "h": 100, "frames": [
        {"transform_matrix": [[1,0,0,1],[0,1,0,0],[0,0,1,0],[0,0,0,1]]},
        {"transform_matrix": [[0,0,1,2],[1,0,0,3],[0,1,0,4],[0,0,0,1]], "fl_x": 50, "w": 100}]}"#,
    );
    let moments: Vec<f64> = got.iter().map(|(_, t)| *t).collect();
    assert_eq!(moments, [0.0, 10.0]);
    let (camera, k) = (got[0].0, got[0].0.intrinsics);
    assert_eq!((k.width, k.height, k.cx, k.cy), (200, 100, 100.0, 50.0));
    assert!((k.fy - 100.0).abs() < 1e-9 && (k.fx - 100.0).abs() < 1e-9);
    assert!((camera.unproject(99.5, 49.5, 3.0) - Vector3::new(1.0, 0.0, -3.0)).norm() < 1e-12);
    let camera = got[1].0;
    assert_eq!(camera.centre(), Vector3::new(2.0, 3.0, 4.0));
    assert!((camera.unproject(49.5, 49.5, 1.0) - Vector3::new(1.0, 3.0, 4.0)).norm() < 1e-12);
    assert!((camera.unproject(99.5, 49.5, 1.0) - Vector3::new(1.0, 4.0, 4.0)).norm() < 1e-12);
    assert!((camera.unproject(49.5, 99.5, 1.0) - Vector3::new(1.0, 3.0, 3.0)).norm() < 1e-12);
}

const IDENTITY: &str = r#""c2w": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"#;

fn own(keyframes: &str) -> String {
    format!(
        r#"{{"format": "minute4d-path", "version": 1, "width": 40, "height": 30, "fps": 24, "keyframes": [{keyframes}]}}"#
    )
}

#[test]
fn keyframes_of_minute4d() {
    let got = keyed(&own(&format!(
        r#"{{"time_s": 0, {IDENTITY}, "fov_y_deg": 45, "scene_s": 1.5}},
        {{"time_s": 2, "position": [1, 2, 3], "look_at": [0, 0, 0], "up": [0, -1, 0], "scene_frame": 4, "speed": 0}},
        {{"time_s": 3, "position": [1, 2, 3], "look_at": [0, 0, 1]}}"#
    )));
    assert_eq!(
        (got.size, got.fps, got.back_s),
        (Some((40, 30)), Some(24.0), None)
    );
    let [a, b, c] = &got.keyframes[..] else {
        panic!("{got:?}")
    };
    assert_eq!(matrix(&a.pose), (Matrix3::identity(), Vector3::zeros()));
    assert_eq!(
        (a.fov_y_deg, a.scene, a.speed),
        (Some(45.0), Some(SceneTime::Seconds(1.5)), None)
    );
    assert_eq!(
        (b.scene, b.speed),
        (Some(SceneTime::Frames(4.0)), Some(0.0))
    );
    let up = Some(-Vector3::y());
    assert_eq!(
        b.pose,
        KeyPose::LookAt {
            position: Vector3::new(1.0, 2.0, 3.0),
            look_at: Vector3::zeros(),
            up
        }
    );
    assert!(matches!(c.pose, KeyPose::LookAt { up: None, .. }));
    let turned = format!(
        r#"{{"format": "minute4d-path", "version": 1, "axes": "opengl", "back_s": 2, "keyframes": [{{"time_s": 0, {IDENTITY}}}]}}"#
    );
    let got = keyed(&turned);
    assert_eq!(
        matrix(&got.keyframes[0].pose).0,
        Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0))
    );
    assert_eq!(got.back_s, Some(2.0));
}

#[test]
fn faults_in_keyframes_are_named() {
    let keyframe = |before: &str| format!(r#"{{{before}, {IDENTITY}}}"#);
    let cases: [(String, &[&str]); 21] = [
        (String::new(), &["no keyframes"]),
        (r#"{"time_s": 0}"#.into(), &["camera 0", "c2w"]),
        (
            keyframe(r#""time_s": 0, "look_at": [0,0,0]"#),
            &["either c2w"],
        ),
        (format!("{{{IDENTITY}}}"), &["time_s"]),
        (
            keyframe(r#""time_s": 0, "fov": 40"#),
            &["unknown field `fov`"],
        ),
        (keyframe(r#""time_s": -1"#), &["time_s is -1"]),
        (keyframe(r#""time_s": NaN"#), &["expected value"]),
        (keyframe(r#""time_s": 1e999"#), &["out of range"]),
        (
            keyframe(r#""time_s": 0, "fov_y_deg": 180"#),
            &["fov_y_deg is 180"],
        ),
        (
            keyframe(r#""time_s": 0, "speed": 1e9"#),
            &["speed is 1e9; -1000 to 1000"],
        ),
        (
            [keyframe(r#""time_s": 1"#), keyframe(r#""time_s": 1"#)].join(","),
            &["camera 1", "not behind"],
        ),
        (
            [
                keyframe(r#""time_s": 0, "speed": 1"#),
                keyframe(r#""time_s": 1, "scene_s": 1"#),
            ]
            .join(","),
            &["camera 0", "speed"],
        ),
        (
            keyframe(r#""time_s": 0, "scene_s": 1, "scene_frame": 1"#),
            &["both"],
        ),
        (
            r#"{"time_s": 0, "c2w": [[2,0,0,0],[0,2,0,0],[0,0,2,0],[0,0,0,1]]}"#.into(),
            &["camera 0", "c2w is not a rotation"],
        ),
        (r#"{"time_s": 0, "c2w": [[1,0,0,0]]}"#.into(), &["1 rows"]),
        (
            r#"{"time_s": 0, "position": [1,1,1], "look_at": [1,1,1]}"#.into(),
            &["same point"],
        ),
        (
            r#"{"time_s": 0, "position": [0,0,0], "look_at": [0,3,0], "up": [0,-1,0]}"#.into(),
            &["up points"],
        ),
        (
            r#"{"time_s": 0, "position": [0,0], "look_at": [0,3,0]}"#.into(),
            &["position has 2"],
        ),
        (
            r#"{"time_s": 0, "position": [0,0,1e12], "look_at": [0,3,0]}"#.into(),
            &["position holds 1e12"],
        ),
        (
            format!("{}{{}}", "{},".repeat(100_000)),
            &["100001 cameras"],
        ),
        ("[".into(), &["is not a camera path"]),
    ];
    for (keyframes, words) in cases {
        refused(&own(&keyframes), words);
    }
    let one = keyframe(r#""time_s": 0"#);
    refused(
        r#"{"format": "minute4d-path", "version": 2, "keyframes": []}"#,
        &["version is 2"],
    );
    refused(r#"{"format": "other", "keyframes": []}"#, &["\"other\""]);
    refused(
        &format!(r#"{{"keyframes": [{one}]}}"#),
        &["\"format\": \"minute4d-path\" is missing"],
    );
    let half = own(&one).replace(r#""height": 30,"#, "");
    refused(&half, &["width and height belong together"]);
}

#[test]
fn faults_in_lists_are_named() {
    let list = |frame: &str| format!(r#"{{"w": 9, "h": 9, "fl_x": 9, "frames": [{{{frame}}}]}}"#);
    let pose = r#""transform_matrix": [[1,0,0,3],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"#;
    for (text, words) in [
        (r#"{"frames": []}"#.to_owned(), &["no frames"][..]),
        (
            list(pose).replace(r#""w": 9, "#, ""),
            &["camera 0", "w, the size"],
        ),
        (list(pose).replace(r#""h": 9"#, r#""h": 9.5"#), &["h = 9.5"]),
        (
            list(r#""transform_matrix": [[1,2,3]]"#),
            &["transform_matrix", "4 rows"],
        ),
        (
            list(&pose.replace("[0,1,0,0]", "[0,-1,0,0]")),
            &["not a rotation"],
        ),
        (list(r#""time": 0"#), &["transform_matrix is missing"]),
        (list(&format!(r#""time": 2, {pose}"#)), &["time = 2"]),
        (list(&format!(r#""k1": 0.1, {pose}"#)), &["distortion"]),
        (list(&format!(r#""fl_x": -1, {pose}"#)), &["fl_x is -1"]),
        ("[1, 2".to_owned(), &["is not a camera path"]),
    ] {
        refused(&text, words);
    }
}
