//! The whole thing on a drawn scene: a wavy wall two metres away, seen by a camera that walks past.

use crate::megasam::cvd::pairs::{FramePair, PairStore, pair_list};
use crate::megasam::cvd::{
    CVD_STEPS, ConsistentDepth, CvdError, CvdInput, PairError, optimise, uncertainty_of_static,
};
use m4_core::{
    CounterRng, Flow, Intrinsics, Plane, Se3, Silent,
    nalgebra::{Vector3, Vector6},
};
use m4_testkit::StopAtPoll;

const SIZE: (usize, usize) = (50, 38);
const FRAMES: usize = 10;

struct Clip {
    c2w: Vec<Se3<f64>>,
    intrinsics: Intrinsics,
    /// Disparity, `[height][width]`.
    truth: Vec<Vec<f64>>,
    /// Off by a factor a frame and by bumps.
    start: Vec<Plane<f32>>,
    pairs: PairStore,
}

/// All lengths times `unit`. Where `moves` says so, the flow is a few pixels off what the camera's
/// motion makes.
fn clip(unit: f64, moves: impl Fn(usize) -> bool) -> Clip {
    let (w, h) = SIZE;
    // a principal point off the middle
    let intrinsics = Intrinsics {
        cx: 23.0,
        cy: 20.5,
        ..Intrinsics::centred(w, h, 45.0)
    };
    let pose = |i: usize| {
        let t = i as f64;
        let twist = Vector6::new(
            0.06 * t,
            0.03 * t.sin(),
            0.02 * t,
            0.01 * t,
            -0.015 * t,
            0.005 * t,
        );
        let mut pose = Se3::<f64>::identity().retract(&twist);
        pose.translation *= unit;
        pose
    };
    let c2w: Vec<Se3<f64>> = (0..FRAMES).map(pose).collect();
    let k = &intrinsics;
    let ray = |p: usize| {
        let (x, y) = ((p % w) as f64 + 0.5, (p / w) as f64 + 0.5);
        Vector3::new((x - k.cx) / k.fx, (y - k.cy) / k.fy, 1.0)
    };
    let depth = |pose: &Se3<f64>, p: usize| {
        let mut z = 2.0 * unit;
        for _ in 0..40 {
            let x = pose.transform(&(ray(p) * z)) / unit;
            z += 0.7 * unit * (2.0 + 0.2 * (2.0 * x.x).sin() * (2.0 * x.y).cos() - x.z);
        }
        z
    };
    let truth: Vec<Vec<f64>> = c2w
        .iter()
        .map(|pose| (0..w * h).map(|p| 1.0 / depth(pose, p)).collect())
        .collect();
    let mut pairs = PairStore::new(w, h, usize::MAX);
    for pair in pair_list(FRAMES) {
        let target_from_source = c2w[pair.target].inverse().compose(&c2w[pair.source]);
        let mut flow = Flow {
            width: w,
            height: h,
            u: Vec::new(),
            v: Vec::new(),
        };
        let mut mask = Vec::new();
        for p in 0..w * h {
            let point = target_from_source.transform(&(ray(p) / truth[pair.source][p]));
            let off = if moves(p) { 4.0 } else { 0.0 };
            let u = k.fx * point.x / point.z + k.cx - 0.5 - off;
            let v = k.fy * point.y / point.z + k.cy - 0.5 + off;
            flow.u.push((u - (p % w) as f64) as f32);
            flow.v.push((v - (p / w) as f64) as f32);
            mask.push(u >= 0.0 && v >= 0.0 && u <= (w - 1) as f64 && v <= (h - 1) as f64);
        }
        pairs.push(pair, &flow, &mask).unwrap();
    }
    let mut rng = CounterRng::new(1, 2, 3);
    let mut start = Vec::new();
    for truth in &truth {
        let factor = 1.0 + 0.2 * (2.0 * rng.uniform() - 1.0);
        let bump =
            |x: usize, y: usize| 1.0 + 0.06 * (0.5 * x as f64).sin() * (0.4 * y as f64).cos();
        start.push(Plane::from_fn(w, h, |x, y| {
            (factor * truth[y * w + x] * bump(x, y)) as f32
        }));
    }
    Clip {
        c2w,
        intrinsics,
        truth,
        start,
        pairs,
    }
}

fn input<'a>(clip: &'a Clip, uncertainty: &'a [Plane<f32>]) -> CvdInput<'a> {
    CvdInput {
        c2w: &clip.c2w,
        intrinsics: clip.intrinsics,
        disparity: &clip.start,
        uncertainty,
    }
}

fn even() -> Vec<Plane<f32>> {
    vec![Plane::filled(SIZE.0, SIZE.1, 0.5); FRAMES]
}

/// Mean of |depth - truth| / truth, without any alignment.
fn abs_rel(clip: &Clip, disparity: &[Plane<f32>], keep: impl Fn(usize) -> bool) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (truth, estimate) in clip.truth.iter().zip(disparity) {
        for p in (0..truth.len()).filter(|&p| keep(p)) {
            sum += (truth[p] / f64::from(estimate.data()[p]) - 1.0).abs();
            count += 1.0;
        }
    }
    sum / count
}

fn optimised(clip: &Clip, steps: [usize; 2]) -> ConsistentDepth {
    optimise(&input(clip, &even()), &clip.pairs, steps, &Silent).unwrap()
}

#[test]
fn frames_agree_with_the_poses_in_their_unit() {
    let clip = clip(1.0, |_| false);
    let before = abs_rel(&clip, &clip.start, |_| true);
    let result = optimised(&clip, CVD_STEPS);
    let after = abs_rel(&clip, &result.disparity, |_| true);
    assert!(
        before > 0.06 && after < 0.35 * before,
        "{before} to {after}"
    );
    assert!(result.losses[1][399] < result.losses[0][0]);
    assert_eq!((result.scale.len(), result.shift.len()), (FRAMES, FRAMES));
    // the first stage undoes most of each frame's factor
    for (i, truth) in clip.truth.iter().enumerate() {
        let n = truth.len() as f64;
        let mean = clip.start[i]
            .data()
            .iter()
            .map(|&d| f64::from(d))
            .sum::<f64>()
            / n;
        let settled = result.scale[i] * mean + result.shift[i];
        assert!(
            (settled * n / truth.iter().sum::<f64>() - 1.0).abs() < 0.06,
            "frame {i}"
        );
    }
}

#[test]
fn another_unit_of_length_changes_nothing_but_the_unit() {
    let [metres, millimetres] =
        [1.0, 1000.0].map(|unit| optimised(&clip(unit, |_| false), [10, 10]));
    for (a, b) in metres.disparity.iter().zip(&millimetres.disparity) {
        for (a, b) in a.data().iter().zip(b.data()) {
            assert!((a - 1000.0 * b).abs() < 0.01 * a, "{a} {b}");
        }
    }
    for i in 0..FRAMES {
        assert!((metres.scale[i] - millimetres.scale[i]).abs() < 1e-3);
        assert!((metres.shift[i] - 1000.0 * millimetres.shift[i]).abs() < 1e-3);
    }
    assert!(metres.shift.iter().any(|s| s.abs() > 1e-3));
}

#[test]
fn dynamic_pixels_get_low_u_and_static_depth_is_unchanged() {
    let moves = |p: usize| (18..32).contains(&(p % SIZE.0)) && (12..26).contains(&(p / SIZE.0));
    let clip = clip(1.0, moves);
    let result = optimised(&clip, [100, 300]);
    let mean = |keep: &dyn Fn(usize) -> bool| {
        let values: Vec<f32> = result
            .uncertainty
            .iter()
            .take(5)
            .flat_map(|u| {
                u.data()
                    .iter()
                    .enumerate()
                    .filter(|(p, _)| keep(*p))
                    .map(|(_, u)| *u)
            })
            .collect();
        f64::from(values.iter().sum::<f32>()) / values.len() as f64
    };
    let (moving, still) = (mean(&moves), mean(&|p| !moves(p)));
    assert!(
        moving < 0.5 * still,
        "u {moving} where it moves, {still} where it is static"
    );
    let rest = abs_rel(&clip, &result.disparity, |p| !moves(p));
    assert!(
        rest < 0.5 * abs_rel(&clip, &clip.start, |p| !moves(p)),
        "{rest}"
    );
}

#[test]
fn it_stops_when_asked() {
    let clip = clip(1.0, |_| false);
    let u = even();
    for polls in 0..7 {
        let stop = StopAtPoll::after(polls);
        let stopped = optimise(&input(&clip, &u), &clip.pairs, [3, 5], &stop).unwrap_err();
        let (stage, step) = if polls < 3 {
            (1, polls)
        } else {
            (2, polls - 3)
        };
        assert!(
            matches!(stopped, CvdError::Cancelled { stage: a, step: b } if (a, b) == (stage, step)),
            "{stopped}"
        );
    }
}

#[test]
fn broken_inputs_are_refused_with_a_reason() {
    let clip = clip(1.0, |_| false);
    let u = even();
    let good = input(&clip, &u);
    let message = |input: &CvdInput<'_>, pairs: &PairStore| {
        optimise(input, pairs, [1, 1], &Silent)
            .unwrap_err()
            .to_string()
    };
    let short = CvdInput {
        c2w: &clip.c2w[1..],
        ..good
    };
    assert!(message(&short, &clip.pairs).contains("disparity has 10 entries where 9"));
    let mut holes = clip.start.clone();
    holes[3].data_mut()[7] = f32::NAN;
    let holed = CvdInput {
        disparity: &holes,
        ..good
    };
    let text = message(&holed, &clip.pairs);
    assert!(text.contains("frame 3") && text.contains("NaN"), "{text}");
    let mut intrinsics = clip.intrinsics;
    intrinsics.fx = -1.0;
    assert!(message(&CvdInput { intrinsics, ..good }, &clip.pairs).contains("focal"));
    let flow = |store: &mut PairStore, source, target, mask: bool| {
        let n = SIZE.0 * SIZE.1;
        let still = Flow {
            width: SIZE.0,
            height: SIZE.1,
            u: vec![0.0; n],
            v: vec![0.0; n],
        };
        store.push(FramePair { source, target }, &still, &vec![mask; n])
    };
    let mut far = PairStore::new(SIZE.0, SIZE.1, 0);
    flow(&mut far, 0, 10, true).unwrap();
    assert!(message(&good, &far).contains("there are 10 frames"));
    assert!(matches!(
        flow(&mut far, 0, 10, true),
        Err(PairError::Input(_))
    ));
    let mut nothing = PairStore::new(SIZE.0, SIZE.1, 0);
    flow(&mut nothing, 0, 1, false).unwrap();
    assert!(message(&good, &nothing).contains("no pixel"));
}

#[test]
fn u_starts_low_in_dynamic_regions() {
    let at = [1.0, 0.5, 0.2, 1e-9, 0.0, f32::NAN].map(uncertainty_of_static);
    assert_eq!(at, [0.5, 0.5, 0.2, 1e-3, 1e-3, 1e-3]);
}
