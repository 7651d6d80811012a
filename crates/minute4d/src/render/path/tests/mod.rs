//! The geometry of every path, in a scene without splats: there, what is looked at is one unit away.

mod bullet;
mod keyed;

use super::source::{Smoothing, stabilised};
use super::{CameraPath, PathConfig, PathOptions, Plan, SourcePath};
use crate::Error;
use crate::render::{Moment, Painter, RenderJob, Stop, TimePath};
use m4_core::{
    Camera, CounterRng, Exposure, Intrinsics, Scene, Se3, SourceFrame, SplatLayout, Splats, log_so3,
    nalgebra::{Vector3, Vector6},
};
use m4_kernels::SimdLevel;

/// A clip of 3 s with a frame a tenth: a camera that goes sideways, turns, and is lit differently as it goes.
fn scene(tremble: f64) -> Scene {
    let source = (0..31u64).map(|i| {
        let mut rng = CounterRng::new(7, 0, i);
        let k = i as f64 / 30.0;
        let mut noise = || tremble * (rng.uniform() - 0.5);
        let twist =
            Vector6::new(0.4 * k + noise(), 0.1 * k * k + noise(), noise(), noise(), 0.3 * k + noise(), noise());
        SourceFrame {
            camera: Camera { intrinsics: Intrinsics::centred(64, 48, 50.0 + k), c2w: Se3::identity().retract(&twist) },
            t: i as f64,
            exposure: Exposure { offset: [k as f32; 3], ..Exposure::IDENTITY },
        }
    });
    Scene {
        splats: Splats::zeros(LAYOUT, 0, 0),
        background: [0.0; 3],
        time_frames: 31,
        duration_s: Some(3.0),
        mip: false,
        near: 0.01,
        source: source.collect(),
    }
}

const LAYOUT: SplatLayout = SplatLayout { isotropic: false, sh_degree: 0, time_degree: 0 };

fn plan_of(scene: &Scene, job: &RenderJob) -> Result<Plan, Error> {
    let mut painter = Painter::new(scene, SimdLevel::detect().unwrap());
    job.plan(scene, &mut painter)
}

fn stops(scene: &Scene, path: CameraPath, options: PathOptions, fps: f64) -> Vec<Stop> {
    let job = RenderJob { options, fps: Some(fps), ..RenderJob::new(path) };
    plan_of(scene, &job).unwrap().stops
}

fn difference(a: &Stop, b: &Stop) -> f64 {
    (a.camera.c2w.matrix() - b.camera.c2w.matrix()).norm()
}

const NONE: PathOptions =
    PathOptions { seconds: None, at: None, amount: None, degrees: None, smooth_s: None, strength: None, hold_s: None };

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
        assert!((stop.camera.c2w.matrix() - frame.camera.c2w.matrix()).norm() < 1e-9, "{i}");
        assert!((stop.t - frame.t).abs() < 1e-9);
    }
    let between = &dense[1];
    assert!((between.exposure.offset[0] - 1.0 / 90.0).abs() < 1e-6, "exposure goes along");
    // At its own rate it is the training path, and twice as long it is twice as slow.
    assert_eq!(stops(&scene, CameraPath::Source, NONE, 10.0).len(), 31);
    let slow = PathOptions { seconds: Some(6.0), ..NONE };
    let slow = stops(&scene, CameraPath::Source, slow, 10.0);
    assert_eq!(slow.len(), 61);
    assert!((slow[10].t - 5.0).abs() < 1e-9);
    let train = stops(&scene, CameraPath::Train, NONE, 30.0);
    assert_eq!(train.len(), 31);
}

#[test]
fn one_time_gives_one_image() {
    let scene = scene(0.0);
    for path in [CameraPath::Train, CameraPath::Source, CameraPath::Stabilised] {
        let at = PathOptions { at: Some(Moment::Seconds(1.25)), ..NONE };
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
    assert!(error.to_string().contains("no cameras of its source"), "{error}");
}

/// Sum of the squared third differences of the positions and of the directions.
fn jerk(stops: &[Stop]) -> f64 {
    let third = |f: &dyn Fn(&Stop) -> Vector3<f64>| {
        stops.windows(4).map(|w| (f(&w[3]) - f(&w[2]) * 3.0 + f(&w[1]) * 3.0 - f(&w[0])).norm_squared()).sum::<f64>()
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
    let config = PathConfig::default();
    for (a, b) in source.iter().zip(&smooth) {
        assert!((a.camera.centre() - b.camera.centre()).norm() < config.stray);
        let turn = log_so3(&(a.camera.c2w.rotation.transpose() * b.camera.c2w.rotation)).norm();
        assert!(turn.to_degrees() < config.stray_deg);
        assert_eq!((a.t, a.exposure), (b.t, b.exposure));
    }
    let off = PathOptions { strength: Some(0.0), ..NONE };
    let same = stops(&scene, CameraPath::Stabilised, off, 30.0);
    for (a, b) in source.iter().zip(&same) {
        // Between its samples the smoothed path is interpolated again.
        assert!(difference(a, b) < 2e-3, "{}", difference(a, b));
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
    let how = Smoothing { sigma_s: 0.5, strength: 1.0, stray: 1.0, stray_rad: 1.0 };
    let smooth = stabilised(&source, &how);
    for i in 0..=60 {
        let t = f64::from(i) * 0.5;
        let off = (smooth.at(t).matrix() - source.at(t).camera.c2w.matrix()).norm();
        assert!(off < 1e-9, "{t}: {off}");
    }
}

#[test]
fn a_path_starts_where_time_is_frozen() {
    let scene = scene(0.0);
    let job = RenderJob { time: TimePath::Freeze(Moment::Frames(20.0)), ..RenderJob::new(CameraPath::Swing) };
    let plan = plan_of(&scene, &job).unwrap();
    assert!(plan.stops.iter().all(|s| s.t == 20.0));
    assert!((plan.stops[0].camera.c2w.matrix() - scene.source[20].camera.c2w.matrix()).norm() < 1e-12);
    assert_eq!((plan.stops.len(), plan.fps), (120, 30.0));
    let middle = plan_of(&scene, &RenderJob::new(CameraPath::Swing)).unwrap();
    assert!((middle.stops[0].camera.c2w.matrix() - scene.source[15].camera.c2w.matrix()).norm() < 1e-12);
}

#[test]
fn endless_paths_are_refused() {
    let scene = scene(0.0);
    let job = RenderJob {
        options: PathOptions { seconds: Some(3600.0), ..NONE },
        fps: Some(240.0),
        ..RenderJob::new(CameraPath::Swing)
    };
    let error = plan_of(&scene, &job).unwrap_err();
    assert!(error.to_string().contains("864000 images"), "{error}");
}

#[test]
fn words_are_paths_and_the_rest_are_files() {
    for word in super::WORDS {
        assert_eq!(CameraPath::named(word).to_string(), word);
        assert!(!matches!(CameraPath::named(word), CameraPath::File(_)));
    }
    let error = plan_of(&scene(0.0), &RenderJob::new(CameraPath::named("swingg"))).unwrap_err();
    assert!(error.to_string().contains("swingg") && error.to_string().contains("bullet"), "{error}");
}
