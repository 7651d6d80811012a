//! Keyframes of a file.

use super::{NONE, plan_of, scene};
use crate::Error;
use crate::render::RenderJob;
use crate::render::path::{CameraPath, PathOptions, Plan};
use m4_core::nalgebra::Vector3;

fn keyed(text: &str, job: &RenderJob) -> Result<Plan, Error> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("path.json");
    std::fs::write(&path, text).unwrap();
    let job = RenderJob { path: CameraPath::File(path), ..job.clone() };
    plan_of(&scene(0.0), &job)
}

#[test]
fn keyed_path_meets_keyframes_and_keeps_targets_centred() {
    let text = r#"{"format": "minute4d-path", "version": 1, "width": 64, "height": 48, "fps": 10, "keyframes": [
        {"time_s": 1, "position": [0, 0, 0], "look_at": [0, 0, 2], "fov_y_deg": 60, "scene_s": 1, "speed": 0},
        {"time_s": 2, "position": [1, 0, 0], "look_at": [0, 0, 2], "fov_y_deg": 30, "speed": 0.5},
        {"time_s": 4, "position": [1, -1, 0], "look_at": [0, 0, 2]}]}"#;
    let plan = keyed(text, &RenderJob::new(CameraPath::Train)).unwrap();
    assert_eq!((plan.stops.len(), plan.fps), (31, 10.0));
    let target = Vector3::new(0.0, 0.0, 2.0);
    for stop in &plan.stops {
        let ([u, v], z) = stop.camera.project(&target);
        assert!((u - 31.5).abs() < 1e-9 && (v - 23.5).abs() < 1e-9 && z > 1.0, "{u} {v}");
    }
    let (a, b, c) = (&plan.stops[0], &plan.stops[10], &plan.stops[30]);
    assert!((b.camera.centre() - Vector3::new(1.0, 0.0, 0.0)).norm() < 1e-9);
    assert!((c.camera.centre() - Vector3::new(1.0, -1.0, 0.0)).norm() < 1e-9);
    assert!((a.camera.intrinsics.fy - 24.0 / 30f64.to_radians().tan()).abs() < 1e-9);
    assert!((b.camera.intrinsics.fy - 24.0 / 15f64.to_radians().tan()).abs() < 1e-9);
    // Frozen for a second, then at half speed: two seconds of the path are one of the scene.
    assert!((a.t - 10.0).abs() < 1e-9 && (b.t - 10.0).abs() < 1e-9 && (c.t - 20.0).abs() < 1e-9);
    let half = RenderJob {
        options: PathOptions { seconds: Some(1.5), ..NONE },
        size: Some((33, 21)),
        ..RenderJob::new(CameraPath::Train)
    };
    let quick = keyed(text, &half).unwrap();
    assert_eq!(quick.stops.len(), 16);
    assert!((quick.stops[5].camera.centre() - b.camera.centre()).norm() < 1e-9);
    assert_eq!((quick.stops[0].camera.intrinsics.width, quick.stops[0].camera.intrinsics.height), (33, 21));
}

#[test]
fn a_closed_path_of_keyframes_has_no_seam() {
    let text = r#"{"format": "minute4d-path", "version": 1, "back_s": 1, "fps": 100, "keyframes": [
        {"time_s": 0, "position": [0, 0, 0], "look_at": [0, 0, 2], "scene_frame": 5},
        {"time_s": 1, "position": [1, 0, 0], "look_at": [0, 0, 2], "scene_frame": 5},
        {"time_s": 2, "position": [0, 1, 0], "look_at": [0, 0, 2], "scene_frame": 5}]}"#;
    let plan = keyed(text, &RenderJob::new(CameraPath::Train)).unwrap();
    let n = plan.stops.len();
    assert_eq!(n, 300);
    let step = |i: usize| plan.stops[(i + 1) % n].camera.centre() - plan.stops[i % n].camera.centre();
    let turns = (0..n).map(|i| (step(i + 1) - step(i)).norm());
    let sharpest = turns.fold(0.0, f64::max);
    assert!(sharpest < 2e-3, "{sharpest}: the path has a corner");
    assert!(plan.stops.iter().all(|s| (s.t - 5.0).abs() < 1e-9));
}

#[test]
fn moments_of_keyframes_lie_in_the_scene() {
    let text = r#"{"format": "minute4d-path", "version": 1, "keyframes": [
        {"time_s": 0, "position": [0, 0, 0], "look_at": [0, 0, 2], "scene_s": 4}]}"#;
    let error = keyed(text, &RenderJob::new(CameraPath::Train)).unwrap_err();
    assert!(error.to_string().contains("4s") && error.to_string().contains("outside"), "{error}");
    let unnamed = text.replace(", \"scene_s\": 4", "");
    assert_eq!(keyed(&unnamed, &RenderJob::new(CameraPath::Train)).unwrap().stops.len(), 1);
    // Time continues to the end of the scene, and stays there.
    let long = r#"{"format": "minute4d-path", "version": 1, "fps": 1, "keyframes": [
        {"time_s": 0, "position": [0, 0, 0], "look_at": [0, 0, 2], "speed": 2},
        {"time_s": 9, "position": [0, 0, 0], "look_at": [0, 0, 2]}]}"#;
    let plan = keyed(long, &RenderJob::new(CameraPath::Train)).unwrap();
    let moments: Vec<f64> = plan.stops.iter().map(|s| s.t).collect();
    assert_eq!(moments[..4], [0.0, 20.0, 30.0, 30.0]);
}
