//! The geometry of every path, in a scene without splats: there, what is looked at is one unit
//! away.

use super::source::{STRAY, STRAY_DEG, stabilised};
use super::{CameraPath, PathOptions, Plan, SourcePath};
use crate::Error;
use crate::render::swing::Bullet;
use crate::render::{Moment, Painter, RenderJob, TimePath};
use m4_core::nalgebra::{Vector3, Vector6};
use m4_core::{
    Camera, CounterRng, Exposure, Intrinsics, Scene, Se3, SourceFrame, SplatLayout, Splats, log_so3,
};
use m4_kernels::SimdLevel;

/// A clip of 3 s with a frame a tenth: a camera that goes sideways, turns, and is lit differently
/// as it goes.
fn scene(tremble: f64) -> Scene {
    let source = (0..31u64).map(|i| {
        let mut rng = CounterRng::new(7, 0, i);
        let k = i as f64 / 30.0;
        let mut noise = || tremble * (rng.uniform() - 0.5);
        let twist = Vector6::new(
            0.4 * k + noise(),
            0.1 * k * k + noise(),
            noise(),
            noise(),
            0.3 * k + noise(),
            noise(),
        );
        SourceFrame {
            camera: Camera {
                intrinsics: Intrinsics::centred(64, 48, 50.0 + k),
                c2w: Se3::identity().retract(&twist),
            },
            t: i as f64,
            exposure: Exposure {
                offset: [k as f32; 3],
                ..Exposure::IDENTITY
            },
            distance_sigma: None,
        }
    });
    Scene {
        duration_s: Some(3.0),
        source: source.collect(),
        ..m4_testkit::bare_scene(Splats::zeros(LAYOUT, 0, 0), 31)
    }
}

const LAYOUT: SplatLayout = SplatLayout {
    isotropic: false,
    sh_degree: 0,
    time_degree: 0,
};

fn plan_of(scene: &Scene, job: &RenderJob) -> Result<Plan, Error> {
    let mut painter = Painter::new(scene, SimdLevel::detect().unwrap());
    job.plan(scene, &mut painter)
}

fn stops(scene: &Scene, path: CameraPath, options: PathOptions, fps: f64) -> Vec<SourceFrame> {
    let job = RenderJob {
        options,
        fps: Some(fps),
        ..RenderJob::new(path)
    };
    plan_of(scene, &job).unwrap().stops
}

fn difference(a: &SourceFrame, b: &SourceFrame) -> f64 {
    (a.camera.c2w.matrix() - b.camera.c2w.matrix()).norm()
}

const NONE: PathOptions = PathOptions {
    seconds: None,
    at: None,
    degrees: None,
};

#[test]
fn the_source_goes_through_its_cameras_at_their_times() {
    let scene = scene(0.05);
    let path = SourcePath::new(&scene, "source").unwrap();
    for frame in &scene.source {
        let stop = path.at(frame.t);
        assert!((stop.camera.c2w.matrix() - frame.camera.c2w.matrix()).norm() < 1e-9);
        assert!((stop.camera.intrinsics.fx - frame.camera.intrinsics.fx).abs() < 1e-9);
        assert_eq!(stop.exposure, frame.exposure);
    }
    // Three times as many images: every third is a frame of the source.
    let dense = stops(&scene, CameraPath::Source, NONE, 30.0);
    assert_eq!(dense.len(), 91);
    for (i, frame) in scene.source.iter().enumerate() {
        let stop = &dense[3 * i];
        assert!(
            (stop.camera.c2w.matrix() - frame.camera.c2w.matrix()).norm() < 1e-9,
            "{i}"
        );
        assert!((stop.t - frame.t).abs() < 1e-9);
    }
    let between = &dense[1];
    assert!(
        (between.exposure.offset[0] - 1.0 / 90.0).abs() < 1e-6,
        "exposure goes along"
    );
    // At its own rate it is the training path, and twice as long it is twice as slow.
    assert_eq!(stops(&scene, CameraPath::Source, NONE, 10.0).len(), 31);
    let slow = PathOptions {
        seconds: Some(6.0),
        ..NONE
    };
    let slow = stops(&scene, CameraPath::Source, slow, 10.0);
    assert_eq!(slow.len(), 61);
    assert!((slow[10].t - 5.0).abs() < 1e-9);
    let train = stops(&scene, CameraPath::Train, NONE, 30.0);
    assert_eq!(train.len(), 31);
}

#[test]
fn one_time_gives_one_image() {
    let scene = scene(0.0);
    for path in [
        CameraPath::Train,
        CameraPath::Source,
        CameraPath::Stabilised,
    ] {
        let at = PathOptions {
            at: Some(Moment::Seconds(1.25)),
            ..NONE
        };
        let one = stops(&scene, path, at, 30.0);
        assert_eq!(one.len(), 1);
        assert!((one[0].t - 12.5).abs() < 1e-9);
    }
}

#[test]
fn times_without_cameras_and_cameras_without_times() {
    let mut scene = scene(0.0);
    scene.source.truncate(1);
    assert_eq!(stops(&scene, CameraPath::Source, NONE, 10.0).len(), 1);
    assert_eq!(stops(&scene, CameraPath::Stabilised, NONE, 10.0).len(), 1);
    assert!(stops(&scene, CameraPath::Bullet, NONE, 10.0).len() >= 40);
    let twice = scene.source[0];
    scene.source.push(twice);
    scene.duration_s = None;
    assert_eq!(stops(&scene, CameraPath::Source, NONE, 10.0).len(), 1);
    scene.source.clear();
    let error = plan_of(&scene, &RenderJob::new(CameraPath::Swing)).unwrap_err();
    assert!(
        error.to_string().contains("no cameras of its source"),
        "{error}"
    );
}

/// Sum of the squared third differences of the positions and of the directions.
fn jerk(stops: &[SourceFrame]) -> f64 {
    let third = |f: &dyn Fn(&SourceFrame) -> Vector3<f64>| {
        stops
            .windows(4)
            .map(|w| (f(&w[3]) - f(&w[2]) * 3.0 + f(&w[1]) * 3.0 - f(&w[0])).norm_squared())
            .sum::<f64>()
    };
    third(&|s| s.camera.centre()) + third(&|s| s.camera.c2w.rotation.column(2).into_owned())
}

#[test]
fn the_stabilised_source_trembles_a_hundred_times_less_and_stays_near() {
    let scene = scene(0.06);
    let source = stops(&scene, CameraPath::Source, NONE, 30.0);
    let smooth = stops(&scene, CameraPath::Stabilised, NONE, 30.0);
    assert_eq!(source.len(), smooth.len());
    let (rough, calm) = (jerk(&source), jerk(&smooth));
    assert!(calm < 0.01 * rough, "{rough} to {calm}");
    for (a, b) in source.iter().zip(&smooth) {
        assert!((a.camera.centre() - b.camera.centre()).norm() < STRAY);
        let turn = log_so3(&(a.camera.c2w.rotation.transpose() * b.camera.c2w.rotation)).norm();
        assert!(turn.to_degrees() < STRAY_DEG);
        assert_eq!((a.t, a.exposure), (b.t, b.exposure));
    }
}

#[test]
fn steady_source_is_unchanged() {
    let mut scene = scene(0.0);
    for (i, frame) in scene.source.iter_mut().enumerate() {
        let k = i as f64 / 30.0;
        frame.camera.c2w = Se3 {
            rotation: m4_core::exp_so3(&Vector3::new(0.0, 0.4 * k, 0.0)),
            translation: Vector3::new(k, 0.5 * k, 0.0),
        };
    }
    let source = SourcePath::new(&scene, "source").unwrap();
    let smooth = stabilised(&source, 1.0);
    for i in 0..=60 {
        let t = f64::from(i) * 0.5;
        let off = (smooth.at(t).matrix() - source.at(t).camera.c2w.matrix()).norm();
        assert!(off < 1e-9, "{t}: {off}");
    }
}

#[test]
fn a_path_starts_where_time_is_frozen() {
    let scene = scene(0.0);
    let job = RenderJob {
        time: TimePath::Freeze(Moment::Frames(20.0)),
        ..RenderJob::new(CameraPath::Swing)
    };
    let plan = plan_of(&scene, &job).unwrap();
    assert!(plan.stops.iter().all(|s| s.t == 20.0));
    assert!(
        (plan.stops[0].camera.c2w.matrix() - scene.source[20].camera.c2w.matrix()).norm() < 1e-12
    );
    assert_eq!((plan.stops.len(), plan.fps), (120, 30.0));
    let middle = plan_of(&scene, &RenderJob::new(CameraPath::Swing)).unwrap();
    assert!(
        (middle.stops[0].camera.c2w.matrix() - scene.source[15].camera.c2w.matrix()).norm() < 1e-12
    );
}

#[test]
fn words_are_paths_and_the_rest_are_files() {
    for word in super::WORDS {
        assert_eq!(CameraPath::named(word).to_string(), word);
        assert!(!matches!(CameraPath::named(word), CameraPath::File(_)));
    }
    let error = plan_of(&scene(0.0), &RenderJob::new(CameraPath::named("swingg"))).unwrap_err();
    assert!(
        error.to_string().contains("swingg") && error.to_string().contains("bullet"),
        "{error}"
    );
}

fn keyed(text: &str, job: &RenderJob) -> Result<Plan, Error> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("path.json");
    std::fs::write(&path, text).unwrap();
    let job = RenderJob {
        path: CameraPath::File(path),
        ..job.clone()
    };
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
        assert!(
            (u - 31.5).abs() < 1e-9 && (v - 23.5).abs() < 1e-9 && z > 1.0,
            "{u} {v}"
        );
    }
    let (a, b, c) = (&plan.stops[0], &plan.stops[10], &plan.stops[30]);
    assert!((b.camera.centre() - Vector3::new(1.0, 0.0, 0.0)).norm() < 1e-9);
    assert!((c.camera.centre() - Vector3::new(1.0, -1.0, 0.0)).norm() < 1e-9);
    assert!((a.camera.intrinsics.fy - 24.0 / 30f64.to_radians().tan()).abs() < 1e-9);
    assert!((b.camera.intrinsics.fy - 24.0 / 15f64.to_radians().tan()).abs() < 1e-9);
    // Frozen for a second, then at half speed: two seconds of the path are one of the scene.
    assert!((a.t - 10.0).abs() < 1e-9 && (b.t - 10.0).abs() < 1e-9 && (c.t - 20.0).abs() < 1e-9);
    let half = RenderJob {
        options: PathOptions {
            seconds: Some(1.5),
            ..NONE
        },
        size: Some((33, 21)),
        ..RenderJob::new(CameraPath::Train)
    };
    let quick = keyed(text, &half).unwrap();
    assert_eq!(quick.stops.len(), 16);
    assert!((quick.stops[5].camera.centre() - b.camera.centre()).norm() < 1e-9);
    assert_eq!(
        (
            quick.stops[0].camera.intrinsics.width,
            quick.stops[0].camera.intrinsics.height
        ),
        (33, 21)
    );
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
    let step =
        |i: usize| plan.stops[(i + 1) % n].camera.centre() - plan.stops[i % n].camera.centre();
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
    assert!(
        error.to_string().contains("4s") && error.to_string().contains("outside"),
        "{error}"
    );
    let unnamed = text.replace(", \"scene_s\": 4", "");
    assert_eq!(
        keyed(&unnamed, &RenderJob::new(CameraPath::Train))
            .unwrap()
            .stops
            .len(),
        1
    );
    // Time continues to the end of the scene, and stays there.
    let long = r#"{"format": "minute4d-path", "version": 1, "fps": 1, "keyframes": [
        {"time_s": 0, "position": [0, 0, 0], "look_at": [0, 0, 2], "speed": 2},
        {"time_s": 9, "position": [0, 0, 0], "look_at": [0, 0, 2]}]}"#;
    let plan = keyed(long, &RenderJob::new(CameraPath::Train)).unwrap();
    let moments: Vec<f64> = plan.stops.iter().map(|s| s.t).collect();
    assert_eq!(moments[..4], [0.0, 20.0, 30.0, 30.0]);
}

#[test]
fn bullet_path_freezes_time_while_the_camera_orbits() {
    let scene = scene(0.0);
    let at = PathOptions {
        at: Some(Moment::Seconds(1.2)),
        ..NONE
    };
    let all = stops(&scene, CameraPath::Bullet, at, 30.0);
    // 3 s of the source, 4 s still, and half of twice 0.4 s for slowing down.
    assert_eq!(all.len(), 1 + (7.4f64 * 30.0).round() as usize);
    let frozen: Vec<&SourceFrame> = all.iter().filter(|s| s.t == all[60].t).collect();
    assert!((all[60].t - 12.0).abs() < 1e-9);
    assert!((119..=121).contains(&frozen.len()), "{}", frozen.len());
    for pair in frozen.windows(2).skip(12).take(92) {
        assert!(difference(pair[0], pair[1]) > 1e-5, "it moves");
    }
    assert!(
        difference(frozen[0], frozen[frozen.len() - 1]) < 3e-3,
        "and comes back"
    );
    let furthest = frozen
        .iter()
        .map(|s| difference(s, frozen[0]))
        .fold(0.0, f64::max);
    assert!(furthest > 0.05, "{furthest}");
    // Time never goes back, and never faster than the source.
    for pair in all.windows(2) {
        let step = pair[1].t - pair[0].t;
        assert!((-1e-9..=10.0 / 30.0 + 1e-9).contains(&step), "{step}");
    }
    assert!(all[0].t.abs() < 1e-9 && (all[all.len() - 1].t - 30.0).abs() < 1e-9);
    // No jump anywhere.
    let largest = all
        .windows(2)
        .map(|p| difference(&p[0], &p[1]))
        .fold(0.0, f64::max);
    assert!(largest < 0.05, "{largest}");
}

#[test]
fn bullet_path_has_the_requested_length() {
    let of = |seconds: f64| Bullet::new(1.2, 3.0, Some(seconds));
    for seconds in [5.0, 7.4, 20.0] {
        assert!(
            (of(seconds).unwrap().seconds() - seconds).abs() < 1e-9,
            "{seconds}"
        );
    }
    assert!(
        of(4.2)
            .unwrap_err()
            .to_string()
            .contains("4.2 seconds leaves no time")
    );
    let cut = of(6.0).unwrap();
    let (first, last) = (cut.at(0.0).0, cut.at(6.0).0);
    assert!(
        first > 0.1 && last < 2.9 && first < 1.2 && last > 1.2,
        "{first} {last}"
    );
}
