//! The completed cloud: a square slides behind a pillar, and tracks know where it is meanwhile.

use crate::on_threads;
use m4_core::{
    Camera, Capture, CaptureFrame, Column, CompactMask, Intrinsics, Plane, Se3, Silent, Splats,
    Tracks,
};
use m4_train::init::{InitConfig, TrackedInit, VelocityInit, initialise};

const WALL: f32 = 4.0;
const SQUARE: f32 = 2.0;
const PILLAR: f32 = 1.5;
/// World units per frame, to the right.
const SPEED: f32 = 0.05;
const FRAMES: usize = 12;
const SIDE: usize = 24;

fn camera() -> Camera {
    Camera {
        intrinsics: Intrinsics::centred(96, 64, 100.0),
        c2w: Se3::identity(),
    }
}

/// The middle of the square.
fn middle(t: usize) -> f32 {
    -0.3 + SPEED * t as f32
}

fn is_pillar(x: usize) -> bool {
    (46..56).contains(&x)
}

fn capture(tracks: Option<Tracks>) -> Capture {
    let (w, h) = (96, 64);
    let square = |t: usize, x: usize, y: usize| {
        let p = camera().unproject(x as f64, y as f64, f64::from(SQUARE));
        !is_pillar(x) && (p.x as f32 - middle(t)).abs() < 0.25 && p.y.abs() < 0.25
    };
    let frame = |t: usize| CaptureFrame {
        name: format!("{t}"),
        camera: camera(),
        t: t as f64,
        rgb: Plane::from_fn(w, h, |x, y| match (square(t, x, y), is_pillar(x)) {
            (true, _) => [200, 40, 40],
            (_, true) => [10, 10, 10],
            _ => [x as u8, 2 * y as u8, 250],
        }),
        depth: Some(
            Plane::from_fn(w, h, |x, y| match (square(t, x, y), is_pillar(x)) {
                (true, _) => SQUARE,
                (_, true) => PILLAR,
                _ => WALL,
            })
            .into(),
        ),
        mask: Some(CompactMask::from_fn(w, h, |x, y| square(t, x, y))),
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

/// A grid of points of the square, known in all frames and seen where the pillar does not hide
/// them; `bend` changes places.
fn tracks(bend: impl Fn(usize, usize, [f32; 3]) -> [f32; 3]) -> Tracks {
    let count = SIDE * SIDE;
    let (mut xyz, mut visible) = (Vec::new(), Vec::new());
    for t in 0..FRAMES {
        for k in 0..count {
            let at = |i: usize| -0.24 + 0.48 * i as f32 / (SIDE - 1) as f32;
            let p = [middle(t) + at(k % SIDE), at(k / SIDE), SQUARE];
            let ([u, _], _) = camera().project(&p.map(f64::from).into());
            visible.push(!is_pillar((u + 0.5) as usize));
            xyz.push(bend(t, k, p));
        }
    }
    Tracks::new(FRAMES, count, xyz, visible).expect("as many as there are points")
}

fn true_tracks() -> Tracks {
    tracks(|_, _, p| p)
}

fn config(tracked: TrackedInit) -> InitConfig {
    InitConfig {
        max_static: Some(4000),
        max_dynamic: 100_000,
        change_threshold: 0.0,
        shell_splats: 0,
        velocity: VelocityInit::Zero,
        tracked,
        ..InitConfig::fast()
    }
}

fn on() -> TrackedInit {
    TrackedInit {
        enabled: true,
        ..TrackedInit::default()
    }
}

fn off() -> TrackedInit {
    TrackedInit {
        enabled: false,
        ..TrackedInit::default()
    }
}

/// Places, colours and times of the dynamic part.
fn moving(splats: &Splats) -> Vec<([f32; 3], [f32; 3], f32)> {
    let first = splats.n_static();
    let column = |c, k: usize, i: usize| splats.column(c, k)[first + i];
    (0..splats.n_dynamic())
        .map(|i| {
            let mean = [0, 1, 2].map(|k| column(Column::Mean, k, i));
            let rgb = [0, 1, 2].map(|k| 0.5 + 0.282_094_8 * column(Column::Colour, k, i));
            (mean, rgb, splats.column(Column::TimeMean, 0)[i])
        })
        .collect()
}

/// Whether a place lies behind the pillar.
fn is_hidden(p: [f32; 3]) -> bool {
    let ([u, _], _) = camera().project(&p.map(f64::from).into());
    p[2] > PILLAR + 0.1 && is_pillar((u + 0.5) as usize)
}

fn run(tracks: Option<Tracks>, tracked: TrackedInit) -> Splats {
    let splats = initialise(&capture(tracks), &config(tracked), &Silent)
        .expect("a usable capture")
        .splats;
    assert!(splats.is_finite());
    splats
}

#[test]
fn a_hidden_region_is_filled_from_the_frames_that_see_it() {
    let without = moving(&run(Some(true_tracks()), off()));
    assert!(without.iter().all(|(p, _, _)| !is_hidden(*p)));
    let with = moving(&run(Some(true_tracks()), on()));
    assert!(with.len() > without.len() + 300);
    let hidden: Vec<_> = with.iter().filter(|(p, _, _)| is_hidden(*p)).collect();
    assert_eq!(
        with.len() - without.len(),
        hidden.len(),
        "nothing else is added"
    );
    for (p, rgb, t) in hidden {
        let x = p[0] - middle(*t as usize);
        assert!(
            x.abs() < 0.25 && (p[2] - SQUARE).abs() < 1e-3,
            "{p:?} at {t}"
        );
        assert!(
            (rgb[0] - 200.0 / 255.0).abs() < 0.02 && rgb[1] < 0.2,
            "{rgb:?}"
        );
    }
    // without tracks nothing happens
    assert_eq!(moving(&run(None, on())), without);
}

#[test]
fn points_of_the_frames_win_where_both_exist() {
    let without = run(Some(true_tracks()), off());
    let hidden = run(Some(true_tracks()), on()).n_dynamic() - without.n_dynamic();
    let everywhere = TrackedInit { seen: true, ..on() };
    let all = run(Some(true_tracks()), everywhere).n_dynamic() - without.n_dynamic();
    let samples = FRAMES * SIDE * SIDE;
    assert!(
        all >= hidden && all - hidden < samples / 20,
        "{all} {hidden} of {samples}"
    );
    // a little behind the surface there is room
    let behind = tracks(|_, _, p| p.map(|v| 1.03 * v));
    let doubled = run(Some(behind), everywhere).n_dynamic() - without.n_dynamic();
    assert!(doubled > samples / 2, "{doubled}");
}

#[test]
fn implausible_track_points_are_dropped() {
    let without = run(None, on()).n_dynamic();
    let everywhere = TrackedInit { seen: true, ..on() };
    let added = |bend: &dyn Fn(usize, usize, [f32; 3]) -> [f32; 3], by: TrackedInit| {
        run(Some(tracks(bend)), by).n_dynamic() - without
    };
    // in front of the pillar and of all else
    assert_eq!(added(&|_, _, p| p.map(|v| 0.6 * v), everywhere), 0);
    // where no camera looks
    assert_eq!(added(&|_, _, p| [p[0], p[1] + 5.0, p[2]], everywhere), 0);
    assert_eq!(added(&|_, _, p| [p[0], p[1], -p[2]], everywhere), 0);
    // far behind the wall: implausible, so it must be rejected
    let far = |_: usize, _: usize, p: [f32; 3]| p.map(|v| 4.0 * v);
    let hidden_far = Tracks::new(
        FRAMES,
        SIDE * SIDE,
        tracks(far).xyz().to_vec(),
        vec![false; FRAMES * SIDE * SIDE],
    );
    let colours = hidden_far
        .unwrap()
        .with_colours(vec![[200, 40, 40]; SIDE * SIDE])
        .unwrap();
    assert_eq!(run(Some(colours.clone()), everywhere).n_dynamic(), without);
    let trusted = colours
        .with_confidence(&vec![0.9; FRAMES * SIDE * SIDE])
        .unwrap();
    assert!(run(Some(trusted), everywhere).n_dynamic() > without + 1000);
    // a jump there and back
    let jump = |t: usize, _: usize, p: [f32; 3]| if t == 6 { [p[0], p[1], 1.6 * p[2]] } else { p };
    let splats = run(Some(tracks(jump)), everywhere);
    assert!(moving(&splats).iter().all(|(p, _, _)| p[2] < 2.5));
    // thinned
    let few = run(Some(true_tracks()), TrackedInit { most: 50, ..on() });
    assert_eq!(few.n_dynamic(), without + 50);
}

#[test]
fn threads_do_not_change_a_bit() {
    let run = |threads| {
        on_threads(threads, || {
            let config = InitConfig {
                velocity: InitConfig::fast().velocity,
                ..config(TrackedInit { seen: true, ..on() })
            };
            initialise(&capture(Some(true_tracks())), &config, &Silent)
                .unwrap()
                .splats
        })
    };
    let bits = |s: &Splats| -> Vec<u32> {
        s.columns()
            .iter()
            .flat_map(|c| c.iter().map(|v| v.to_bits()))
            .collect()
    };
    assert_eq!(bits(&run(1)), bits(&run(3)));
}
