//! Initialisation of a capture that brings tracks: a plain band across the image, whose motion no
//! image shows.

use crate::on_threads;
use m4_core::{
    Camera, Capture, CaptureFrame, CompactMask, Intrinsics, Plane, Se3, ShapeError, Silent, Splats,
    Tracks,
};
use m4_train::init::{InitConfig, InitError, TrackedInit, VelocityInit, initialise};

const WALL: f32 = 4.0;
const BAND: f32 = 2.0;
/// World units per frame, along the band.
const SPEED: f32 = 0.03;
const FRAMES: usize = 6;

fn capture(tracks: Option<Tracks>) -> Capture {
    let (w, h) = (96, 64);
    let camera = Camera {
        intrinsics: Intrinsics::centred(w, h, 100.0),
        c2w: Se3::identity(),
    };
    let band = |y: usize| (26..38).contains(&y);
    let frame = |i: usize| CaptureFrame {
        name: format!("{i}"),
        camera,
        t: i as f64,
        rgb: Plane::from_fn(w, h, |x, y| {
            if band(y) {
                [200, 40, 40]
            } else {
                [x as u8, 2 * y as u8, 90]
            }
        }),
        depth: Some(Plane::from_fn(w, h, |_, y| if band(y) { BAND } else { WALL }).into()),
        mask: Some(CompactMask::from_fn(w, h, |_, y| band(y))),
        motion: None,
        instances: None,
        camera_index: None,
        distance_sigma: None,
    };
    Capture {
        frames: (0..FRAMES).map(frame).collect(),
        time_frames: FRAMES,
        duration_s: None,
        metric: true,
        tracks,
    }
}

/// Points on the band at distance `z`, that move along it; every fifth is wrong by far, and each is
/// known in some frames only.
fn tracks(z: f32) -> Result<Tracks, ShapeError> {
    let count = 60;
    let place = |i: usize| {
        let (t, k) = (i / count, i % count);
        let start = [
            -0.9 + 0.06 * (k / 2) as f32,
            if k.is_multiple_of(2) { -0.06 } else { 0.06 },
            z,
        ];
        let speed = if k % 5 == 4 { -0.1 } else { SPEED };
        if k % 3 == 1 && t < 2 {
            return [f32::NAN; 3];
        }
        [start[0] + speed * t as f32, start[1], start[2]]
    };
    let n = FRAMES * count;
    Tracks::new(FRAMES, count, (0..n).map(place).collect(), vec![true; n])
}

fn config() -> InitConfig {
    InitConfig {
        max_static: Some(2000),
        max_dynamic: 2000,
        change_threshold: 0.0,
        shell_splats: 0,
        // their velocities alone are looked at here
        tracked: TrackedInit {
            enabled: false,
            ..TrackedInit::default()
        },
        ..InitConfig::fast()
    }
}

/// The configuration with or without tracks.
fn with_tracks(on: bool) -> InitConfig {
    let mut config = config();
    if let VelocityInit::Register { tracks } = &mut config.velocity {
        *tracks = on;
    }
    config
}

/// Velocities along x of the nodes that carry the dynamic part.
fn speeds(splats: &Splats) -> Vec<f32> {
    let [window] = splats.windows().as_slice() else {
        panic!("one window")
    };
    let place = |key: usize, node: usize| window.poses(key)[node].position[0];
    let last = FRAMES - 1;
    (0..window.anchors().len())
        .map(|node| (place(last, node) - place(0, node)) / last as f32)
        .collect()
}

fn same_bits(a: &Splats, b: &Splats) -> bool {
    let bits = |s: &Splats| -> Vec<u32> {
        s.columns()
            .iter()
            .flat_map(|c| c.iter().map(|v| v.to_bits()))
            .collect()
    };
    bits(a) == bits(b) && a.bindings() == b.bindings() && a.windows() == b.windows()
}

#[test]
fn points_move_as_the_tracks_near_them_do() {
    let alone = initialise(&capture(None), &with_tracks(true), &Silent)
        .unwrap()
        .splats;
    let still = speeds(&alone).iter().all(|v| v.abs() < 0.5 * SPEED);
    assert!(
        still,
        "nothing in the images shows the motion: {:?}",
        speeds(&alone)
    );
    let tracked = initialise(
        &capture(Some(tracks(BAND).unwrap())),
        &with_tracks(true),
        &Silent,
    )
    .unwrap()
    .splats;
    let v = speeds(&tracked);
    assert!(v.len() > 50 && tracked.bindings().len() * 10 > tracked.n_dynamic() * 8);
    let good = v
        .iter()
        .filter(|v| (**v - SPEED).abs() < 0.15 * SPEED)
        .count();
    assert!(
        good * 10 > v.len() * 8,
        "{good} of {} have the speed of the tracks",
        v.len()
    );
}

#[test]
fn tracks_that_are_far_or_not_wanted_change_nothing() {
    let alone = initialise(&capture(None), &with_tracks(true), &Silent)
        .unwrap()
        .splats;
    let far = initialise(
        &capture(Some(tracks(3.5).unwrap())),
        &with_tracks(true),
        &Silent,
    )
    .unwrap()
    .splats;
    assert!(same_bits(&alone, &far));
    let unwanted = initialise(
        &capture(Some(tracks(BAND).unwrap())),
        &with_tracks(false),
        &Silent,
    )
    .unwrap()
    .splats;
    assert!(same_bits(&alone, &unwanted));
    let tracked = initialise(
        &capture(Some(tracks(BAND).unwrap())),
        &with_tracks(true),
        &Silent,
    )
    .unwrap()
    .splats;
    assert!(!same_bits(&alone, &tracked));
}

#[test]
fn threads_do_not_change_a_bit() {
    let run = |threads| {
        on_threads(threads, || {
            initialise(
                &capture(Some(tracks(BAND).unwrap())),
                &with_tracks(true),
                &Silent,
            )
            .unwrap()
            .splats
        })
    };
    assert!(same_bits(&run(1), &run(3)));
}

#[test]
fn tracks_of_another_clip_are_refused_and_degenerate_tracks_are_ignored() {
    let other = Tracks::new(2, 1, vec![[0.0; 3]; 2], vec![true; 2]).unwrap();
    let error = initialise(&capture(Some(other)), &with_tracks(true), &Silent).unwrap_err();
    assert_eq!(
        error,
        InitError::Tracks {
            frames: FRAMES,
            tracks: 2
        }
    );
    // all in one place, or none at all
    for count in [0, 1, 500] {
        let n = FRAMES * count;
        let odd = Tracks::new(FRAMES, count, vec![[0.0, 0.0, BAND]; n], vec![true; n]).unwrap();
        let splats = initialise(&capture(Some(odd)), &with_tracks(true), &Silent)
            .unwrap()
            .splats;
        assert!(splats.is_finite());
    }
}
