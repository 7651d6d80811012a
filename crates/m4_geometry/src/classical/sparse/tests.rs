//! From synthetic tracks to reconstructions with known answers.

use super::luma::WorkingSize;
use super::reconstruct::{FeatureTracks, from_tracks};
use super::tracking::RawTrack;
use super::{SparseConfig, SparseError};
use crate::classical::{CameraMotion, Motion, SparseReconstruction, Track};
use m4_core::advice::FIELD_OF_VIEW;
use m4_core::{
    Camera, CounterRng, Intrinsics, Plane, Se3, Silent, Sim3, exp_so3, log_so3, nalgebra::Vector3,
};
use m4_testkit::StopAtPoll;

mod lens;
mod loops;
mod rival;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;

/// What the camera and the points do.
#[derive(Clone, Copy)]
struct Scene {
    frames: usize,
    points: usize,
    focal: f64,
    /// Units per frame; the room is some 10 units deep.
    step: f64,
    /// Which way it goes.
    way: [f64; 3],
    /// Radians per frame.
    turn: f64,
    /// Focal length of the last frame over that of the first.
    zoom: f64,
    /// Share of points that move.
    moving: f64,
    noise_px: f64,
}

const ROOM: Scene = Scene {
    frames: 30,
    points: 500,
    focal: 520.0,
    step: 0.05,
    way: [1.0, 0.6, 0.3],
    turn: 0.006,
    zoom: 1.0,
    moving: 0.2,
    noise_px: 0.15,
};

impl Scene {
    fn pose(&self, frame: usize) -> Se3<f64> {
        let t = frame as f64;
        let sway = (0.3 * t).sin();
        Se3 {
            rotation: exp_so3(&(Vector3::new(0.3 * sway, t, 0.2 * sway) * self.turn)),
            translation: Vector3::new(self.way[0] * t, self.way[1] * sway, self.way[2] * t)
                * -self.step,
        }
    }

    fn focal(&self, frame: usize) -> f64 {
        self.focal * self.zoom.powf(frame as f64 / (self.frames - 1) as f64)
    }

    /// Tracks and, for each, whether its point moves.
    fn tracks(&self) -> (Vec<RawTrack>, Vec<bool>) {
        let mut rng = CounterRng::new(21, 0, 0);
        let (mut tracks, mut is_dynamic) = (Vec::new(), Vec::new());
        for i in 0..self.points {
            let birth = rng.below(self.frames + 12).saturating_sub(12);
            let life = 6 + rng.below(self.frames);
            let depth = 3.0 + 7.0 * rng.uniform();
            let pixel = [WIDTH, HEIGHT].map(|n| n as f64 * (rng.uniform() - 0.5));
            let focal = self.focal(birth);
            let ray = Vector3::new(pixel[0] / focal, pixel[1] / focal, 1.0);
            let x = self.pose(birth).inverse().transform(&(ray * depth));
            let moves = (i as f64) < self.moving * self.points as f64;
            let direction = Vector3::from_fn(|_, _| 0.06 * rng.normal());
            let mut track = RawTrack {
                first: birth,
                seen: Vec::new(),
                again: Vec::new(),
            };
            for frame in birth..(birth + life).min(self.frames) {
                let t = (frame - birth) as f64;
                let bend = Vector3::new((0.4 * t).sin(), (0.5 * t).cos(), 0.0) * 0.1;
                let at = if moves { x + direction * t + bend } else { x };
                let p = self.pose(frame).transform(&at);
                let focal = self.focal(frame);
                let q = [focal * p.x / p.z, focal * p.y / p.z];
                if p.z < 0.5 || q[0].abs() > WIDTH as f64 / 2.0 || q[1].abs() > HEIGHT as f64 / 2.0
                {
                    break;
                }
                track.seen.push(q.map(|v| v + self.noise_px * rng.normal()));
            }
            if track.seen.len() >= 2 {
                tracks.push(track);
                is_dynamic.push(moves);
            }
        }
        (tracks, is_dynamic)
    }
}

fn features(tracks: Vec<RawTrack>, frames: usize) -> FeatureTracks {
    FeatureTracks {
        tracks,
        frames,
        size: [WIDTH, HEIGHT],
        working: WorkingSize::new(WIDTH, HEIGHT, WIDTH),
    }
}

fn solve(
    tracks: Vec<RawTrack>,
    frames: usize,
    config: &SparseConfig,
) -> Result<SparseReconstruction, SparseError> {
    from_tracks(features(tracks, frames), None, config, &Silent).map(|r| r.sparse)
}

/// A reconstruction of the scene's tracks, of which all is unknown, and which of them move.
fn solved(scene: &Scene) -> (SparseReconstruction, Vec<bool>) {
    let (tracks, is_dynamic) = scene.tracks();
    let reconstruction = solve(tracks, scene.frames, &SparseConfig::default());
    (reconstruction.expect("a reconstruction"), is_dynamic)
}

#[test]
fn it_stops_when_asked() {
    let scene = Scene { frames: 12, ..ROOM };
    let features = features(scene.tracks().0, scene.frames);
    let config = SparseConfig::default();
    let go = |stop: &StopAtPoll| from_tracks(features.clone(), None, &config, stop).map(|_| ());
    let counter = StopAtPoll::after(usize::MAX);
    go(&counter).unwrap();
    let polls = counter.asked();
    assert!(polls > 50, "asked {polls} times only");
    for at in (0..polls).step_by(polls / 16) {
        let stopped = go(&StopAtPoll::after(at));
        assert!(
            matches!(stopped, Err(SparseError::Cancelled)),
            "{stopped:?}"
        );
    }
}

/// Tracks with this motion whose points move, or do not.
fn judged(
    reconstruction: &SparseReconstruction,
    is_dynamic: &[bool],
    motion: Motion,
    moves: bool,
) -> usize {
    let pairs = reconstruction.tracks.iter().zip(is_dynamic);
    pairs
        .filter(|(t, m)| t.motion == motion && **m == moves)
        .count()
}

fn misjudged(reconstruction: &SparseReconstruction, is_dynamic: &[bool]) -> usize {
    judged(reconstruction, is_dynamic, Motion::Static, true)
        + judged(reconstruction, is_dynamic, Motion::Dynamic, false)
}

/// Trajectory error over path length after alignment, and the greatest rotation error in radians
/// relative to frame 0.
fn errors(reconstruction: &SparseReconstruction, scene: &Scene) -> (f64, f64) {
    let ours: Vec<Se3<f64>> = reconstruction.cameras.iter().map(|c| c.c2w).collect();
    let want: Vec<Se3<f64>> = (0..scene.frames).map(|i| scene.pose(i).inverse()).collect();
    let since = |poses: &[Se3<f64>], i: usize| poses[0].rotation.tr_mul(&poses[i].rotation);
    let turn = |i| log_so3(&since(&ours, i).tr_mul(&since(&want, i))).norm();
    let turn = (0..scene.frames).map(turn).fold(0.0, f64::max);
    let centres = |poses: &[Se3<f64>]| poses.iter().map(|p| p.translation).collect::<Vec<_>>();
    let (ours, want) = (centres(&ours), centres(&want));
    let path: f64 = want.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    let Some(fit) = Sim3::umeyama(&ours, &want) else {
        return (f64::INFINITY, turn);
    };
    let squared: f64 = ours
        .iter()
        .zip(&want)
        .map(|(a, b)| (fit.transform(a) - b).norm_squared())
        .sum();
    ((squared / want.len() as f64).sqrt() / path, turn)
}

#[test]
fn a_room_with_a_fifth_of_moving_points() {
    let (reconstruction, is_dynamic) = solved(&ROOM);
    let (trajectory, turn) = errors(&reconstruction, &ROOM);
    let focal = reconstruction.cameras[0].intrinsics.fx;
    assert_eq!(reconstruction.camera_motion, CameraMotion::Parallax);
    assert!(trajectory < 0.004, "trajectory error {trajectory}");
    assert!(turn < 0.005, "rotation error {turn}");
    assert!((focal / ROOM.focal - 1.0).abs() < 0.02, "focal {focal}");
    assert!(
        reconstruction.residual_px < 0.3 && reconstruction.warnings.is_empty(),
        "{:?}",
        reconstruction.warnings
    );
    let judged =
        |motion: Motion, moves: bool| judged(&reconstruction, &is_dynamic, motion, moves) as f64;
    let (hit, miss) = (judged(Motion::Dynamic, true), judged(Motion::Static, true));
    assert!(
        hit > 0.85 * (hit + miss),
        "{hit} of {} moving tracks found",
        hit + miss
    );
    let (rest, wrong) = (
        judged(Motion::Static, false),
        judged(Motion::Dynamic, false),
    );
    assert!(
        wrong < 0.02 * (rest + wrong),
        "{wrong} of {} resting tracks called moving",
        rest + wrong
    );
    // The world is the first camera, and the median depth is 1.
    assert!((reconstruction.cameras[0].c2w.matrix() - Se3::identity().matrix()).norm() < 1e-9);
    for (t, moves) in reconstruction.tracks.iter().zip(&is_dynamic) {
        if let (Some(x), false) = (t.point, moves) {
            let (p, z) = reconstruction.cameras[t.first_frame].project(&x);
            let o = t.observations[0];
            assert!(z > 0.0 && (p[0] - f64::from(o[0])).hypot(p[1] - f64::from(o[1])) < 3.0);
        }
    }
}

#[test]
fn other_lenses_and_a_walk_straight_ahead_are_reconstructed() {
    let walk = Scene {
        step: 0.06,
        way: [0.0, 0.02, 1.0],
        turn: 0.001,
        moving: 0.0,
        ..ROOM
    };
    for (what, scene, focal_off, path_off) in [
        (
            "wide lens",
            Scene {
                focal: 300.0,
                ..ROOM
            },
            0.03,
            0.01,
        ),
        (
            "long lens",
            Scene {
                focal: 900.0,
                ..ROOM
            },
            0.05,
            0.01,
        ),
        ("walk", walk, f64::INFINITY, 0.02),
    ] {
        let (reconstruction, _) = solved(&scene);
        assert_eq!(
            reconstruction.camera_motion,
            CameraMotion::Parallax,
            "{what}: {:?}",
            reconstruction.warnings
        );
        let (focal, path) = (
            reconstruction.cameras[0].intrinsics.fx,
            errors(&reconstruction, &scene).0,
        );
        assert!(
            (focal / scene.focal - 1.0).abs() < focal_off && path < path_off,
            "{what}: {focal} {path}"
        );
    }
}

#[test]
fn given_focal_length_and_static_camera_are_used() {
    let solve = |config| solve(ROOM.tracks().0, ROOM.frames, &config).expect("a reconstruction");
    let reconstruction = solve(SparseConfig {
        focal_px: Some(530.0),
        fov_deg: Some(40.0),
        ..SparseConfig::default()
    });
    assert!((reconstruction.cameras[0].intrinsics.fx - 530.0).abs() < 1e-9);
    assert!(errors(&reconstruction, &ROOM).0 < 0.02);
    let reconstruction = solve(SparseConfig {
        static_camera: true,
        fov_deg: Some(60.0),
        ..SparseConfig::default()
    });
    assert_eq!(reconstruction.camera_motion, CameraMotion::Static);
    let fov = reconstruction.cameras[0]
        .intrinsics
        .horizontal_fov_rad()
        .to_degrees();
    assert!((fov - 60.0).abs() < 1e-9, "{fov}");
}

#[test]
fn turning_camera_gives_rotations_and_is_reported() {
    let scene = Scene {
        step: 0.0,
        turn: 0.012,
        moving: 0.1,
        ..ROOM
    };
    let (reconstruction, is_dynamic) = solved(&scene);
    assert_eq!(reconstruction.camera_motion, CameraMotion::RotationOnly);
    let focal = reconstruction.cameras[0].intrinsics.fx;
    assert!((focal / scene.focal - 1.0).abs() < 0.15, "focal {focal}");
    assert!(
        errors(&reconstruction, &scene).1 < 0.05,
        "{}",
        errors(&reconstruction, &scene).1
    );
    assert!(
        reconstruction
            .cameras
            .iter()
            .all(|c| c.centre().norm() == 0.0)
    );
    assert!(reconstruction.tracks.iter().all(|t| t.point.is_none()));
    assert_eq!(
        reconstruction.warnings.len(),
        1,
        "{:?}",
        reconstruction.warnings
    );
    assert!(judged(&reconstruction, &is_dynamic, Motion::Dynamic, false) < 20);
}

#[test]
fn zoom_gives_rotations_and_intrinsics_per_frame() {
    let scene = Scene {
        step: 0.0,
        zoom: 1.8,
        ..ROOM
    };
    let (tracks, is_dynamic) = scene.tracks();
    let reconstruction = solve(tracks.clone(), scene.frames, &SparseConfig::default()).unwrap();
    assert_eq!(
        reconstruction.camera_motion,
        CameraMotion::RotationOnly,
        "{:?}",
        reconstruction.warnings
    );
    assert_eq!(
        reconstruction.warnings.len(),
        1,
        "{:?}",
        reconstruction.warnings
    );
    assert!(
        reconstruction.warnings[0].contains("the lens zooms"),
        "{:?}",
        reconstruction.warnings
    );
    let lens = |frame: usize| reconstruction.cameras[frame].intrinsics.fx;
    assert!(
        (lens(29) / lens(0) / 1.8 - 1.0).abs() < 0.01,
        "{} {}",
        lens(0),
        lens(29)
    );
    // Tracks are where they were seen.
    let (observation, raw) = (reconstruction.tracks[7].observations[3], tracks[7].seen[3]);
    for (k, middle) in [320.0, 240.0].into_iter().enumerate() {
        assert!(
            (f64::from(observation[k]) + 0.5 - middle - raw[k]).abs() < 1e-3,
            "{observation:?} {raw:?}"
        );
    }
    assert!(misjudged(&reconstruction, &is_dynamic) * 10 < is_dynamic.len());
    // A given field of view is that of the first frame.
    let told = SparseConfig {
        focal_px: Some(520.0),
        ..SparseConfig::default()
    };
    let reconstruction = solve(tracks, scene.frames, &told).unwrap();
    let lens = |frame: usize| reconstruction.cameras[frame].intrinsics.fx;
    assert!(
        (lens(0) - 520.0).abs() < 1e-6 && (lens(29) / 936.0 - 1.0).abs() < 0.01,
        "{} {}",
        lens(0),
        lens(29)
    );
}

#[test]
fn a_camera_on_a_tripod_gives_one_pose() {
    let scene = Scene {
        step: 0.0,
        turn: 0.0,
        ..ROOM
    };
    let (reconstruction, is_dynamic) = solved(&scene);
    assert_eq!(reconstruction.camera_motion, CameraMotion::Static);
    assert!(
        reconstruction
            .cameras
            .iter()
            .all(|c| c.c2w == Se3::identity())
    );
    assert!(
        reconstruction.warnings[0].contains(FIELD_OF_VIEW),
        "{:?}",
        reconstruction.warnings
    );
    let dynamic =
        [true, false].map(|moves| judged(&reconstruction, &is_dynamic, Motion::Dynamic, moves));
    assert!(dynamic[0] > 60 && dynamic[1] == 0, "{dynamic:?}");
}

#[test]
fn noise_is_refused_with_numbers() {
    let mut rng = CounterRng::new(5, 0, 0);
    let tracks: Vec<RawTrack> = (0..300)
        .map(|_| {
            let mut p = [600.0 * (rng.uniform() - 0.5), 440.0 * (rng.uniform() - 0.5)];
            let speed = [6.0 * rng.normal(), 6.0 * rng.normal()];
            let positions = (0..20)
                .map(|_| {
                    p = [0, 1].map(|k| p[k] + speed[k] + 4.0 * rng.normal());
                    p
                })
                .collect();
            RawTrack {
                first: 0,
                seen: positions,
                again: Vec::new(),
            }
        })
        .collect();
    let error = solve(tracks, 20, &SparseConfig::default()).unwrap_err();
    assert!(matches!(error, SparseError::NoAgreement(_)), "{error}");
    let error = error.to_string();
    assert!(
        !error.contains("of 0 ")
            && ["no two frames", "tracks fit"]
                .iter()
                .any(|s| error.contains(s)),
        "{error}"
    );
}

#[test]
fn a_cut_is_reported_where_it_is() {
    let (mut tracks, _) = ROOM.tracks();
    for t in &mut tracks {
        t.seen.truncate(14_usize.saturating_sub(t.first));
    }
    tracks.retain(|t| t.seen.len() >= 2);
    let error = solve(tracks, ROOM.frames, &SparseConfig::default())
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("only 0 points could be tracked from frame 13"),
        "{error}"
    );
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let (reconstruction, _) = pool.expect("a pool").install(|| solved(&ROOM));
        (reconstruction.cameras, reconstruction.residual_px)
    };
    assert_eq!(run(1), run(3));
}

/// Points and motion of the room's tracks, for cameras that are given.
fn posed(cameras: &[Camera]) -> Result<SparseReconstruction, SparseError> {
    let features = features(ROOM.tracks().0, ROOM.frames);
    features
        .with_cameras(cameras, None, &SparseConfig::default(), &Silent)
        .map(|r| r.sparse)
}

fn room_cameras(focal: f64) -> Vec<Camera> {
    let camera = |i| Camera {
        intrinsics: Intrinsics::centred(WIDTH, HEIGHT, focal),
        c2w: ROOM.pose(i).inverse(),
    };
    (0..ROOM.frames).map(camera).collect()
}

#[test]
fn given_cameras_are_used_and_points_are_in_their_unit() {
    let cameras = room_cameras(ROOM.focal);
    let reconstruction = posed(&cameras).expect("a reconstruction");
    assert_eq!(reconstruction.cameras, cameras);
    assert_eq!(reconstruction.camera_motion, CameraMotion::Parallax);
    assert!(
        reconstruction.residual_px < 0.3,
        "{}",
        reconstruction.residual_px
    );
    assert!(misjudged(&reconstruction, &ROOM.tracks().1) < ROOM.points / 20);
    let depth = |t: &Track| Some(cameras[t.first_frame].project(&t.point?).1);
    let depths: Vec<f64> = reconstruction.tracks.iter().filter_map(depth).collect();
    let inside = depths.iter().filter(|z| (2.5..11.0).contains(*z)).count();
    assert!(
        depths.len() > 150 && inside * 20 > depths.len() * 19,
        "{} of {}",
        inside,
        depths.len()
    );
}

#[test]
fn given_cameras_that_contradict_the_images_are_rejected() {
    let right = room_cameras(ROOM.focal);
    let mut turned = right.clone();
    for (i, camera) in turned.iter_mut().enumerate() {
        camera.c2w.rotation =
            exp_so3(&Vector3::new(0.0, 1.3 * (i % 3) as f64, 0.0)) * camera.c2w.rotation;
    }
    // The last two thirds of the way are walked backwards.
    let backwards: Vec<Camera> = (0..ROOM.frames)
        .map(|i| right[if i < 10 { i } else { 39 - i }])
        .collect();
    let mut broken = right.clone();
    broken[3].c2w.translation.x = f64::NAN;
    for (wrong, words) in [
        (&turned[..], "the given poses do not fit"),
        (&backwards, "the given poses contradict the images"),
        (&right[1..], "cameras"),
        (&broken, "frame 3"),
    ] {
        let error = posed(wrong).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn tracks_in_given_masks_are_dynamic_and_excluded() {
    let (tracks, _) = ROOM.tracks();
    let left = Plane::from_fn(64, 48, |x, _| u8::from(x < 16));
    let masks = vec![&left; ROOM.frames];
    let count = tracks.len();
    let features = features(tracks, ROOM.frames);
    let result = from_tracks(features, Some(&masks), &SparseConfig::default(), &Silent);
    let reconstruction = result.expect("a reconstruction").sparse;
    assert_eq!(reconstruction.tracks.len(), count);
    let inside = |t: &&Track| t.observations.iter().all(|p| p[0] < 150.0);
    let masked: Vec<&Track> = reconstruction.tracks.iter().filter(inside).collect();
    assert!(
        masked.len() > 20
            && masked
                .iter()
                .all(|t| t.motion == Motion::Dynamic && t.point.is_none())
    );
    let (trajectory, turn) = errors(&reconstruction, &ROOM);
    assert!(trajectory < 0.01 && turn < 0.01, "{trajectory} {turn}");
}

#[test]
fn off_centre_principal_point_gives_the_same_cameras() {
    // The same rays as a lens with another centre, and pixels that are not square, has them.
    let (mut tracks, _) = ROOM.tracks();
    let [fx, fy, cx, cy] = [500.0, 540.0, 350.0, 230.0];
    for at in tracks.iter_mut().flat_map(|t| &mut t.seen) {
        at[0] = at[0] / ROOM.focal * fx + cx - WIDTH as f64 / 2.0;
        at[1] = at[1] / ROOM.focal * fy + cy - HEIGHT as f64 / 2.0;
    }
    let config = SparseConfig {
        intrinsics: Some([fx, fy, cx, cy]),
        ..SparseConfig::default()
    };
    let reconstruction = solve(tracks, ROOM.frames, &config).expect("a reconstruction");
    let k = reconstruction.cameras[0].intrinsics;
    assert_eq!([k.fx, k.fy, k.cx, k.cy], [fx, fy, cx, cy]);
    let (trajectory, turn) = errors(&reconstruction, &ROOM);
    assert!(trajectory < 0.01 && turn < 0.005, "{trajectory} {turn}");
}
