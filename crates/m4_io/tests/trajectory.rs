//! Camera paths of every layout, against numbers worked out by hand.

use m4_core::nalgebra::{Matrix3, Vector3};
use m4_io::ErrorKind;
use m4_io::trajectory::{self, KeyPose, Keyed, Listed, ReadTrajectoryError, SceneTime, Trajectory};

fn load(text: &str) -> Result<Trajectory, ReadTrajectoryError> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("path.json");
    std::fs::write(&path, text).unwrap();
    trajectory::load(&path, 11)
}

fn listed(text: &str) -> Listed {
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
    let said = error.to_string();
    for word in words.iter().chain(&["path.json"]) {
        assert!(said.contains(word), "{word:?} is not in {said:?}");
    }
}

fn matrix(pose: &KeyPose) -> (Matrix3<f64>, Vector3<f64>) {
    match pose {
        KeyPose::C2w(c2w) => (c2w.rotation, c2w.translation),
        KeyPose::LookAt { .. } => panic!("no matrix"),
    }
}

#[test]
fn a_camera_path_of_the_nerfstudio_viewer() {
    // One unit along x, looking along -z, 90 degrees high.
    let got = listed(
        r#"{"camera_type": "perspective", "render_height": 100, "render_width": 200, "fps": 24, "seconds": 4,
        "is_cycle": false, "smoothness_value": 0, "crop": {"crop_center": [0, 0, 0]},
        "camera_path": [
          {"camera_to_world": [1,0,0,1, 0,1,0,0, 0,0,1,0, 0,0,0,1], "fov": 90, "aspect": 2},
          {"camera_to_world": [0,0,1,2, 1,0,0,3, 0,1,0,4, 0,0,0,1], "fov": 90, "aspect": 2}],
        "keyframes": [{"matrix": "[1,0,0,0,0,1,0,0,0,0,1,0,9,0,0,1]", "fov": 50, "aspect": 2}]}"#,
    );
    assert_eq!(got.fps, Some(24.0));
    assert!(
        got.remarks.len() == 1 && got.remarks[0].contains("crop"),
        "{:?}",
        got.remarks
    );
    let moments: Vec<f64> = got.cameras.iter().map(|(_, t)| *t).collect();
    assert_eq!(moments, [0.0, 10.0]);
    let camera = got.cameras[0].0;
    let k = camera.intrinsics;
    assert_eq!((k.width, k.height, k.cx, k.cy), (200, 100, 100.0, 50.0));
    assert!((k.fy - 50.0).abs() < 1e-9 && (k.fx - 50.0).abs() < 1e-9);
    assert!((camera.unproject(99.5, 49.5, 3.0) - Vector3::new(1.0, 0.0, -3.0)).norm() < 1e-12);
    // The second: right is y, up is z, back is x, so it looks along -x with -z downwards.
    let camera = got.cameras[1].0;
    assert_eq!(camera.centre(), Vector3::new(2.0, 3.0, 4.0));
    assert!((camera.unproject(99.5, 49.5, 1.0) - Vector3::new(1.0, 3.0, 4.0)).norm() < 1e-12);
    assert!((camera.unproject(149.5, 49.5, 1.0) - Vector3::new(1.0, 4.0, 4.0)).norm() < 1e-12);
    assert!((camera.unproject(99.5, 99.5, 1.0) - Vector3::new(1.0, 3.0, 3.0)).norm() < 1e-12);
}

#[test]
fn keyframes_of_the_nerfstudio_viewer_as_text_and_as_numbers() {
    // Text is column-major, numbers are row-major.
    let got = keyed(
        r#"{"render_height": 10, "render_width": 20, "fps": 25, "default_transition_sec": 1.5, "default_fov": 40, "is_cycle": true,
        "keyframes": [
          {"matrix": "[1,0,0,0,0,1,0,0,0,0,1,0,9,8,7,1]", "fov": 50, "render_time": 0.5},
          {"matrix": [0,0,1,2, 1,0,0,3, 0,1,0,4, 0,0,0,1], "override_transition_enabled": true, "override_transition_sec": 0.5},
          {"matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1], "override_transition_enabled": false, "override_transition_sec": 9}]}"#,
    );
    assert_eq!((got.size, got.fps, got.back_s), (Some((20, 10)), Some(25.0), Some(1.5)));
    let times: Vec<f64> = got.keyframes.iter().map(|k| k.time_s).collect();
    assert_eq!(times, [0.0, 0.5, 2.0]);
    let (rotation, centre) = matrix(&got.keyframes[0].pose);
    assert_eq!(centre, Vector3::new(9.0, 8.0, 7.0));
    assert_eq!(rotation, Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)));
    assert_eq!(got.keyframes[0].scene, Some(SceneTime::Frames(5.0)));
    assert_eq!(
        (got.keyframes[0].fov_y_deg, got.keyframes[1].fov_y_deg),
        (Some(50.0), Some(40.0))
    );
    let (rotation, centre) = matrix(&got.keyframes[1].pose);
    assert_eq!(centre, Vector3::new(2.0, 3.0, 4.0));
    assert_eq!(rotation.column(2), -Vector3::x());
    assert_eq!(rotation.column(1), -Vector3::z());
    assert_eq!(rotation.column(0), Vector3::y());
}

#[test]
fn transforms_have_either_axes() {
    let got = listed(
        r#"{"fl_x": 30, "w": 20, "h": 10, "axes": "opencv", "frames": [
        {"transform_matrix": [[1,0,0,3],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "time": 1.0}]}"#,
    );
    assert_eq!(got.cameras[0].1, 10.0);
    assert!((got.cameras[0].0.unproject(9.5, 4.5, 2.0) - Vector3::new(3.0, 0.0, 2.0)).norm() < 1e-12);
}

const IDENTITY: &str = r#""c2w": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"#;

fn own(keyframes: &str) -> String {
    format!(
        r#"{{"format": "minute4d-path", "version": 1, "width": 40, "height": 30, "fps": 24, "keyframes": [{keyframes}]}}"#
    )
}

#[test]
fn our_own_keyframes() {
    let got = keyed(&own(&format!(
        r#"{{"time_s": 0, {IDENTITY}, "fov_y_deg": 45, "scene_s": 1.5}},
        {{"time_s": 2, "position": [1, 2, 3], "look_at": [0, 0, 0], "up": [0, -1, 0], "scene_frame": 4, "speed": 0}},
        {{"time_s": 3, "position": [1, 2, 3], "look_at": [0, 0, 1]}}"#
    )));
    assert_eq!((got.size, got.fps, got.back_s), (Some((40, 30)), Some(24.0), None));
    let [a, b, c] = &got.keyframes[..] else {
        panic!("{got:?}")
    };
    assert_eq!(matrix(&a.pose), (Matrix3::identity(), Vector3::zeros()));
    assert_eq!(
        (a.fov_y_deg, a.scene, a.speed),
        (Some(45.0), Some(SceneTime::Seconds(1.5)), None)
    );
    assert_eq!((b.scene, b.speed), (Some(SceneTime::Frames(4.0)), Some(0.0)));
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
fn faults_in_our_own_keyframes_are_named() {
    refused(&own(""), &["no keyframes"]);
    refused(&own(r#"{"time_s": 0}"#), &["camera 0", "c2w"]);
    refused(
        &own(&format!(r#"{{"time_s": 0, {IDENTITY}, "look_at": [0,0,0]}}"#)),
        &["either c2w"],
    );
    refused(&own(&format!("{{{IDENTITY}}}")), &["time_s"]);
    refused(
        &own(&format!(r#"{{"time_s": 0, "fov": 40, {IDENTITY}}}"#)),
        &["unknown field `fov`"],
    );
    refused(&own(&format!(r#"{{"time_s": -1, {IDENTITY}}}"#)), &["time_s = -1"]);
    refused(&own(&format!(r#"{{"time_s": NaN, {IDENTITY}}}"#)), &["expected value"]);
    refused(&own(&format!(r#"{{"time_s": 1e999, {IDENTITY}}}"#)), &["out of range"]);
    refused(
        &own(&format!(r#"{{"time_s": 0, "fov_y_deg": 180, {IDENTITY}}}"#)),
        &["fov_y_deg = 180"],
    );
    refused(
        &own(&format!(r#"{{"time_s": 0, "speed": 1e9, {IDENTITY}}}"#)),
        &["speed = 1000000000"],
    );
    refused(
        &own(&format!(r#"{{"time_s": 1, {IDENTITY}}}, {{"time_s": 1, {IDENTITY}}}"#)),
        &["camera 1", "not behind"],
    );
    refused(
        &own(&format!(
            r#"{{"time_s": 0, "speed": 1, {IDENTITY}}}, {{"time_s": 1, "scene_s": 1, {IDENTITY}}}"#
        )),
        &["camera 0", "speed"],
    );
    refused(
        &own(r#"{"time_s": 0, "c2w": [[2,0,0,0],[0,2,0,0],[0,0,2,0],[0,0,0,1]]}"#),
        &["camera 0", "c2w is not a rotation"],
    );
    refused(&own(r#"{"time_s": 0, "c2w": [[1,0,0,0]]}"#), &["1 rows"]);
    refused(
        &own(r#"{"time_s": 0, "position": [1,1,1], "look_at": [1,1,1]}"#),
        &["same point"],
    );
    refused(
        &own(r#"{"time_s": 0, "position": [0,0,0], "look_at": [0,3,0], "up": [0,-1,0]}"#),
        &["up points"],
    );
    refused(
        &own(r#"{"time_s": 0, "position": [0,0], "look_at": [0,3,0]}"#),
        &["position has 2"],
    );
    refused(
        &own(r#"{"time_s": 0, "position": [0,0,1e12], "look_at": [0,3,0]}"#),
        &["position ="],
    );
    refused(
        r#"{"format": "minute4d-path", "version": 2, "keyframes": []}"#,
        &["version is 2"],
    );
    refused(r#"{"format": "other", "keyframes": []}"#, &["\"other\""]);
    refused(
        &format!(r#"{{"keyframes": [{{"time_s": 0, {IDENTITY}}}]}}"#),
        &["\"format\": \"minute4d-path\" is missing"],
    );
    let half = own(&format!(r#"{{"time_s": 0, {IDENTITY}}}"#)).replace(r#""height": 30,"#, "");
    refused(&half, &["width and height belong together"]);
}

#[test]
fn faults_in_lists_are_named() {
    refused(r#"{"frames": []}"#, &["no frames"]);
    refused(
        r#"{"frames": [{"transform_matrix": [[1,0,0,3],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#,
        &["camera 0", "render_width"],
    );
    let path = |camera: &str| format!(r#"{{"render_width": 9, "render_height": 9, "camera_path": [{camera}]}}"#);
    refused(
        &path(r#"{"camera_to_world": [1,2,3], "fov": 9}"#),
        &["camera_to_world", "4 rows"],
    );
    refused(
        &path(r#"{"camera_to_world": [1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1], "fov": 270}"#),
        &["fov = 270"],
    );
    refused(
        &path(r#"{"camera_to_world": [1,0,0,0,0,-1,0,0,0,0,1,0,0,0,0,1], "fov": 70}"#),
        &["not a rotation"],
    );
    refused(&path(r#"{"fov": 70}"#), &["camera_to_world is missing"]);
    let fisheye = path(r#"{"camera_to_world": [1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1], "fov": 90}"#);
    refused(
        &fisheye.replace("{\"render_width\"", "{\"camera_type\": \"fisheye\", \"render_width\""),
        &["fisheye"],
    );
    let many = format!(r#"{{"camera_path": [{}{{}}]}}"#, "{},".repeat(100_000));
    refused(&many, &["100001 cameras"]);
    refused("[1, 2", &["is not a camera path"]);
    refused("{\"keyframes\": [{}]}", &["neither a matrix"]);
    refused(r#"{"keyframes": [{"matrix": "[1, 2"}]}"#, &["camera 0", "matrix"]);
    refused(r#"{"keyframes": [{"matrix": [1, 2]}]}"#, &["2 numbers"]);
    refused(
        r#"{"default_transition_sec": 0, "keyframes": [{"matrix": [1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}, {"matrix": [1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}]}"#,
        &["camera 1", "transition takes 0"],
    );
}
