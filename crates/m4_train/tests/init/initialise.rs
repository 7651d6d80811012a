//! Initialisation of a synthetic capture: a wall, and a square that slides in front of it.

use crate::on_threads;
use m4_core::{
    Camera, Capture, CaptureFrame, Column, CompactMask, Intrinsics, Plane, Se3, Silent, Splats,
    nalgebra::Vector3,
};
use m4_train::init::{FirstSplats, InitConfig, InitError, TimeSpread, VelocityInit, initialise};

const WALL: f64 = 4.0;
const SQUARE: f64 = 2.0;
/// World units per frame, to the right.
const SPEED: f64 = 0.04;

/// A colour that tells places apart.
fn texture(x: f64, y: f64) -> [u8; 3] {
    let wave =
        |phase: f64| (127.5 + 120.0 * (9.0 * x + phase).sin() * (7.0 * y - phase).cos()) as u8;
    [wave(0.0), wave(1.3), wave(2.9)]
}

fn capture(frames: usize) -> Capture {
    let (w, h) = (96, 64);
    let make = |i: usize| {
        let mut c2w = Se3::identity();
        c2w.translation = Vector3::new(0.01 * i as f64, 0.0, 0.0);
        let camera = Camera {
            intrinsics: Intrinsics::centred(w, h, 100.0),
            c2w,
        };
        let square = |x: usize, y: usize| {
            let p = camera.unproject(x as f64, y as f64, SQUARE);
            let (u, v) = (p.x - SPEED * i as f64 + 0.3, p.y);
            (u.abs() < 0.25 && v.abs() < 0.25).then(|| texture(u, v))
        };
        let wall = |x: usize, y: usize| {
            let p = camera.unproject(x as f64, y as f64, WALL);
            texture(0.3 * p.x + 5.0, p.y)
        };
        let depth = Plane::from_fn(w, h, |x, y| match square(x, y) {
            Some(_) => SQUARE as f32,
            None => WALL as f32,
        });
        CaptureFrame {
            name: format!("{i:03}"),
            camera,
            t: i as f64,
            rgb: Plane::from_fn(w, h, |x, y| square(x, y).unwrap_or_else(|| wall(x, y))),
            depth: Some(depth.into()),
            mask: Some(CompactMask::from_fn(w, h, |x, y| square(x, y).is_some())),
            motion: None,
            instances: None,
            camera_index: None,
            distance_sigma: None,
        }
    };
    Capture {
        frames: (0..frames).map(make).collect(),
        time_frames: frames,
        duration_s: None,
        metric: true,
        tracks: None,
    }
}

fn fast() -> InitConfig {
    InitConfig {
        max_static: Some(2000),
        max_dynamic: 2000,
        change_threshold: 0.0,
        shell_splats: 0,
        ..InitConfig::fast()
    }
}

fn mean(splats: &Splats, row: usize) -> [f32; 3] {
    [0, 1, 2].map(|k| splats.column(Column::Mean, k)[row])
}

#[test]
fn static_and_dynamic_points_are_separated() {
    let splats = initialise(&capture(8), &fast(), &Silent).unwrap().splats;
    assert!(splats.is_finite());
    assert!(
        (1000..=2000).contains(&splats.n_static()),
        "{} static",
        splats.n_static()
    );
    assert!(
        (200..=1000).contains(&splats.n_dynamic()),
        "{} dynamic: those of all frames are one",
        splats.n_dynamic()
    );
    for row in 0..splats.n() {
        let z = if row < splats.n_static() {
            WALL
        } else {
            SQUARE
        };
        assert!(
            (f64::from(mean(&splats, row)[2]) - z).abs() < 1e-3,
            "splat {row} is not on its surface"
        );
    }
    let times = splats.column(Column::TimeMean, 0);
    let (bound, free) = times.split_at(splats.bindings().len());
    assert!([bound, free].iter().all(|times| times.is_sorted()));
    let sd = &splats.column(Column::LogTimeSd, 0)[bound.len()..];
    assert!(
        sd.iter().all(|&v| (v.exp() - 1.0).abs() < 1e-4),
        "a gap of one frame"
    );
}

#[test]
fn splats_of_a_sliding_square_are_carried_with_it_for_the_whole_clip() {
    let splats = initialise(&capture(8), &fast(), &Silent).unwrap().splats;
    let whole = |life: [f32; 2]| life == [f32::NEG_INFINITY, f32::INFINITY];
    let lasting = splats.bindings().iter().filter(|b| whole(b.life)).count();
    assert!(
        lasting * 10 > splats.n_dynamic() * 8,
        "{lasting} of {}",
        splats.n_dynamic()
    );
    let [window] = splats.windows().as_slice() else {
        panic!("one window")
    };
    assert_eq!(window.keys(), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    for node in 0..window.anchors().len() {
        let place = |key: usize| window.poses(key)[node].position;
        let v: Vec<f64> = (0..3)
            .map(|k| f64::from(place(7)[k] - place(0)[k]) / 7.0)
            .collect();
        assert!(
            (v[0] - SPEED).abs() < 0.03 * SPEED && v[1].abs() < 0.03 * SPEED && v[2].abs() < 1e-3,
            "{v:?}"
        );
    }
}

/// A square that turns white at once is another square: no life passes the change.
#[test]
fn a_life_ends_where_frames_contradict_it() {
    let mut capture = capture(10);
    for frame in &mut capture.frames[5..] {
        let mask = frame.mask.clone().unwrap();
        let before = frame.rgb.clone();
        let other = |x, y| match mask.covers((x, y), (96, 64)) {
            true => [255; 3],
            false => before[(x, y)],
        };
        frame.rgb = Plane::from_fn(96, 64, other);
    }
    let splats = initialise(&capture, &fast(), &Silent).unwrap().splats;
    let birth = splats.column(Column::TimeMean, 0);
    let (mut before, mut after, mut across) = (0, 0, 0);
    for (binding, birth) in splats.bindings().iter().zip(birth) {
        let [begin, end] = binding.life;
        assert!(begin < *birth && *birth < end);
        match (begin < 4.0, end > 5.0) {
            (true, true) => across += 1,
            (true, false) => before += 1,
            (false, _) => after += 1,
        }
    }
    assert!(
        before > 100 && after > 100 && across * 20 < before,
        "{before} {after} {across}"
    );
}

#[test]
fn the_faithful_profile_has_one_scale_and_fades_everything() {
    let config = InitConfig {
        max_static: Some(1000),
        max_dynamic: 500,
        ..InitConfig::faithful()
    };
    let splats = initialise(&capture(8), &config, &Silent).unwrap().splats;
    assert_eq!(splats.n_static(), 0);
    assert!(splats.layout().isotropic);
    assert!(splats.column(Column::Velocity, 0).iter().all(|&v| v == 0.0));
    let opacity = splats.column(Column::Opacity, 0)[0];
    assert!((1.0 / (1.0 + (-opacity).exp()) - 0.1).abs() < 1e-6);
    // static: variance D = 3 of a time axis of length 3, that is 7 / sqrt(3) frames about a third
    // of it
    let (mean, sd) = (
        splats.column(Column::TimeMean, 0),
        splats.column(Column::LogTimeSd, 0),
    );
    assert!((mean[0] - 7.0 / 3.0).abs() < 1e-5 && (sd[0].exp() - 7.0 / 3.0f32.sqrt()).abs() < 1e-4);
    // moving: sqrt(7 / 30) frames
    let last = sd[sd.len() - 1];
    assert!((last.exp() - (7.0f32 / 30.0).sqrt()).abs() < 1e-4);
}

#[test]
fn a_shadow_on_the_wall_is_laid_over_it() {
    let mut capture = capture(8);
    // from frame 4 on, the right edge of the image is in the shade
    for frame in &mut capture.frames[4..] {
        let lit = frame.rgb.clone();
        frame.rgb = Plane::from_fn(96, 64, |x, y| {
            lit[(x, y)].map(|c| if x >= 88 { c / 2 } else { c })
        });
    }
    let config = InitConfig {
        change_threshold: 0.05,
        velocity: VelocityInit::Zero,
        ..fast()
    };
    let plain = initialise(
        &capture,
        &InitConfig {
            change_threshold: 0.0,
            ..config.clone()
        },
        &Silent,
    )
    .unwrap()
    .splats;
    let splats = initialise(&capture, &config, &Silent).unwrap().splats;
    assert_eq!(splats.n_static(), plain.n_static());
    assert!(splats.n_dynamic() > plain.n_dynamic() + 50);
    // every splat that is not on the square lies just before the wall, on its right
    let mut dark = 0;
    for i in 0..splats.n_dynamic() {
        let [x, _, z] = mean(&splats, splats.n_static() + i);
        if z > 3.0 {
            assert!(z < 4.0 && z > 3.9 && x > 0.5, "splat {i} at {x}, {z}");
            let late = splats.column(Column::TimeMean, 0)[i] >= 4.0;
            let black = splats.column(Column::Colour, 0)[splats.n_static() + i] < 0.0;
            assert_eq!(late, black, "dark when the shadow is there, bright before");
            dark += usize::from(black);
        }
    }
    assert!(dark > 20);
}

#[test]
fn the_shell_lies_behind_everything_and_is_fixed_but_where_pixels_have_no_surface() {
    let config = InitConfig {
        shell_splats: 300,
        ..fast()
    };
    let mut capture = capture(4);
    let n = initialise(&capture, &fast(), &Silent)
        .unwrap()
        .splats
        .n_static();
    let FirstSplats { splats, fixed } = initialise(&capture, &config, &Silent).unwrap();
    assert_eq!((splats.n_static(), fixed), (n + 300, n..n + 300));
    for row in n..n + 300 {
        let r = mean(&splats, row).iter().map(|v| v * v).sum::<f32>().sqrt();
        assert!(r > 7.5, "radius {r} where the wall is at 4");
    }
    for frame in &mut capture.frames {
        frame.depth =
            Some(Plane::from_fn(96, 64, |_, y| if y < 20 { 0.0 } else { WALL as f32 }).into());
    }
    let FirstSplats { splats, fixed } = initialise(&capture, &config, &Silent).unwrap();
    let sky = splats.n_static() - 300..fixed.start;
    assert!(sky.len() > 2 && fixed.end == splats.n_static());
    assert!(
        sky.clone().all(|row| mean(&splats, row)[1] < 0.0),
        "above the wall"
    );
}

#[test]
fn without_masks_everything_is_static() {
    let mut capture = capture(3);
    for frame in &mut capture.frames {
        frame.mask = None;
    }
    let splats = initialise(&capture, &fast(), &Silent).unwrap().splats;
    assert!(splats.n_static() > 0 && splats.n_dynamic() == 0);
}

#[test]
fn missing_and_useless_depth_are_clear_errors() {
    let mut none = capture(3);
    none.frames.iter_mut().for_each(|f| f.depth = None);
    assert_eq!(
        initialise(&none, &fast(), &Silent),
        Err(InitError::NoDepth { frames: 3 })
    );
    let mut zero = capture(2);
    zero.frames
        .iter_mut()
        .for_each(|f| f.depth = Some(Plane::filled(96, 64, f32::NAN).into()));
    let message = initialise(&zero, &fast(), &Silent).unwrap_err().to_string();
    assert!(
        message.contains("no usable depth in 2 depth maps"),
        "{message}"
    );
    let mut bad = capture(2);
    bad.frames[1].camera.intrinsics.fx = f64::NAN;
    assert_eq!(
        initialise(&bad, &fast(), &Silent),
        Err(InitError::BadCamera {
            frame: "001".to_owned()
        })
    );
    let empty = Capture {
        frames: Vec::new(),
        ..capture(1)
    };
    assert_eq!(
        initialise(&empty, &fast(), &Silent),
        Err(InitError::NoFrames)
    );
}

#[test]
fn one_frame_is_enough_and_depth_may_have_its_own_size() {
    let mut one = capture(1);
    one.frames[0].depth = Some(Plane::filled(48, 32, WALL as f32).into());
    let splats = initialise(&one, &fast(), &Silent).unwrap().splats;
    assert!(splats.is_finite() && splats.n_static() > 500 && splats.n_dynamic() > 10);
}

/// Splats next to missing frames live longer: as long as the mean gap to both neighbours.
#[test]
fn lifetimes_reach_over_missing_frames() {
    let mut capture = capture(8);
    capture
        .frames
        .retain(|frame| frame.t != 3.0 && frame.t != 4.0);
    let still = InitConfig {
        velocity: VelocityInit::Zero,
        ..fast()
    };
    let splats = initialise(&capture, &still, &Silent).unwrap().splats;
    assert!(splats.bindings().is_empty(), "motion is not looked for");
    let (mean, sd) = (
        splats.column(Column::TimeMean, 0),
        splats.column(Column::LogTimeSd, 0),
    );
    for (t, sd) in mean.iter().zip(sd) {
        let want = if [2.0, 5.0].contains(t) { 2.0 } else { 1.0 };
        assert!(
            (sd.exp() - want).abs() < 1e-4,
            "{} for {want} at {t}",
            sd.exp()
        );
    }
    assert!([2.0, 5.0].iter().all(|t| mean.contains(t)));
}

#[test]
fn threads_do_not_change_a_bit() {
    let capture = capture(5);
    let run = |threads| {
        on_threads(threads, || {
            initialise(&capture, &fast(), &Silent).unwrap().splats
        })
    };
    let (one, three) = (run(1), run(3));
    for (a, b) in one.columns().iter().zip(three.columns()) {
        assert!(a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits()));
    }
    assert_eq!(
        (one.bindings(), one.windows()),
        (three.bindings(), three.windows())
    );
    let other = InitConfig {
        velocity: VelocityInit::Zero,
        time_spread: TimeSpread::KeyframeGaps { factor: 2.0 },
        ..fast()
    };
    let still = initialise(&capture, &other, &Silent).unwrap().splats;
    assert!((still.column(Column::LogTimeSd, 0)[0] - 2.0f32.ln()).abs() < 1e-6);
}

/// Two cameras film the same instants: what lies between them is no motion.
#[test]
fn frames_of_one_instant_make_no_endless_velocities() {
    let mut capture = capture(8);
    for (i, frame) in capture.frames.iter_mut().enumerate() {
        frame.t = (i / 2) as f64;
    }
    capture.time_frames = 4;
    let splats = initialise(&capture, &fast(), &Silent).unwrap().splats;
    assert!(splats.n_dynamic() > 100 && splats.is_finite());
    assert_eq!(
        splats.windows()[0].keys(),
        [0.0, 1.0, 2.0, 3.0],
        "one key an instant"
    );
    for k in 0..3 {
        let fastest = splats
            .column(Column::Velocity, k)
            .iter()
            .fold(0.0f32, |m, v| m.max(v.abs()));
        assert!(fastest < 1.0, "{fastest} world units a frame");
    }
}
