//! Depth of what stands still, made to agree over time (consistent video depth, [`crate::cvd`]).
//!
//! Flow is asked what it adds: a pair whose flow does not lead to where depth that several frames agreed on leads is left out.
//! A network's flow may be off by a pixel all over an image, and chained over frames by more, which would spoil
//! depth that was right.
//!
//! Works on planes of half the working size; what comes back is a factor a pixel, so the edges of the working size stay.

use super::error::DenseError;
use super::flow::{Flow, FlowPair, bilinear};
use super::pair::Pair;
use super::shot::quantile;
use crate::cvd::pairs::{FlowView, FramePair, PairSource, PairStore, consistency_mask, pair_list};
use crate::cvd::{CvdError, CvdInput, CvdSettings, optimise, uncertainty_of_static};
use m4_math::Se3;
use m4_scene::{Cache, Camera, Plane, Progress};

/// What is known of the clip; planes are `[height][width]` by frame, at the working size.
pub(super) struct Clip<'a> {
    pub width: usize,
    pub height: usize,
    pub cameras: &'a [Camera],
    pub flows: &'a [FlowPair],
    /// Above 0 where something moves.
    pub moving: &'a [Vec<u8>],
    /// Share of the partners that agree.
    pub confidence: &'a [Vec<f32>],
}

/// How firmly pixels on which all partners agree stay where they are.
const PRIOR: f32 = 1.0;
/// Flow of a pair counts if it misses where measured depth leads by at most this share of the parallax, medians over the measured
/// pixels.
const FLOW_MISS: f32 = 0.06;
/// Memory for flow; more goes to a temporary file, bytes.
const FLOW_BYTES: usize = 512 << 20;
const PHASE: &str = "making depth consistent";

fn halved(flow: &Flow) -> Flow {
    flow.resized(flow.width / 2, flow.height / 2)
}

/// Follows `there` by `step`.
fn chained(there: &Flow, step: &Flow) -> Flow {
    let mut out = there.clone();
    for p in 0..there.u.len() {
        let (x, y) = (
            (p % there.width) as f32 + there.u[p],
            (p / there.width) as f32 + there.v[p],
        );
        let (u, v) = step.at(x, y);
        (out.u[p], out.v[p]) = (there.u[p] + u, there.v[p] + v);
    }
    out
}

fn view(flow: &Flow) -> FlowView<'_> {
    FlowView {
        width: flow.width,
        height: flow.height,
        x: &flow.u,
        y: &flow.v,
    }
}

/// Pixels on which at least this share of the partners agrees judge flow, if there are as many of them in a pair.
const SURE: f32 = 0.5;
const JUDGES: usize = 100;

/// Flow of a pair at half the working size, and which of its pixels count.
struct Led<'a> {
    pair: FramePair,
    flow: &'a Flow,
    counts: &'a [bool],
}

/// How far the flow of a pair misses where the measured depth leads, as a share of the parallax that tells this depth from
/// none: medians over what was measured. `None` where too little was measured to tell.
fn miss(clip: &Clip<'_>, disparity: &[Vec<f32>], led: &Led<'_>) -> Option<f32> {
    let (w, h) = (led.flow.width, led.flow.height);
    let FramePair { source, target } = led.pair;
    let camera = |i: usize| Camera {
        intrinsics: clip.cameras[i].intrinsics.resized(w, h),
        ..clip.cameras[i]
    };
    let cameras = Pair::new(&camera(source), &camera(target));
    let (mut misses, mut parallax) = (Vec::new(), Vec::new());
    for p in (0..w * h).filter(|&p| led.counts[p]) {
        let (x, y) = (p % w, p / w);
        let at = 2 * y * clip.width + 2 * x;
        if clip.confidence[source][at] >= SURE {
            let (x, y) = (x as f32, y as f32);
            let (far, seen) = (cameras.project(x, y, 0.0), cameras.project(x, y, disparity[source][at]));
            misses.push((seen.x - x - led.flow.u[p]).hypot(seen.y - y - led.flow.v[p]));
            parallax.push((seen.x - far.x).hypot(seen.y - far.y));
        }
    }
    if misses.len() < JUDGES {
        return None;
    }
    Some(quantile(&mut misses, 0.5)? / quantile(&mut parallax, 0.5)?)
}

/// Flow of every pair of the list, chained from neighbour to neighbour, where it is sure and nothing moves; and how many
/// pairs were left out because measured depth (`disparity`) contradicts their flow.
fn pairs(clip: &Clip<'_>, disparity: &[Vec<f32>], progress: &dyn Progress) -> Result<(PairStore, usize), DenseError> {
    let (w, h) = (clip.width / 2, clip.height / 2);
    let frames = clip.cameras.len();
    let mut store = PairStore::new(w, h, FLOW_BYTES);
    let mut left_out = 0;
    let forward: Vec<Flow> = clip.flows.iter().map(|f| halved(&f.forward)).collect();
    let backward: Vec<Flow> = clip.flows.iter().map(|f| halved(&f.backward)).collect();
    let still = |i: usize, x: f32, y: f32| {
        let (x, y) = ((2.0 * x + 1.0) as usize, (2.0 * y + 1.0) as usize);
        clip.moving[i][y.min(clip.height - 1) * clip.width + x.min(clip.width - 1)] == 0
    };
    for FramePair { source, target } in pair_list(frames) {
        if progress.cancelled() {
            return Err(DenseError::Cancelled { phase: PHASE });
        }
        let mut there = forward[source].clone();
        for flow in &forward[source + 1..target] {
            there = chained(&there, flow);
        }
        let mut back = backward[target - 1].clone();
        for flow in backward[source..target - 1].iter().rev() {
            back = chained(&back, flow);
        }
        let mut mask = consistency_mask(view(&there), view(&back));
        for (p, sure) in mask.iter_mut().enumerate() {
            let (x, y) = ((p % w) as f32, (p / w) as f32);
            *sure = *sure && still(source, x, y) && still(target, x + there.u[p], y + there.v[p]);
        }
        let pair = FramePair { source, target };
        let led = Led {
            pair,
            flow: &there,
            counts: &mask,
        };
        if miss(clip, disparity, &led).is_some_and(|miss| miss.is_nan() || miss > FLOW_MISS) {
            left_out += 1;
            continue;
        }
        store.push(pair, view(&there), &mask).map_err(CvdError::from)?;
    }
    Ok((store, left_out))
}

/// Factors on the disparity of every pixel, `[height][width]` by frame; `None`, with a warning, if no flow is good enough to
/// say anything.
pub(super) fn factors(
    clip: &Clip<'_>,
    disparity: &[Vec<f32>],
    settings: &CvdSettings,
    progress: &dyn Progress,
    cache: &dyn Cache,
) -> Result<Option<Vec<Vec<f32>>>, DenseError> {
    let (w, h) = (clip.width / 2, clip.height / 2);
    let (store, left_out) = pairs(clip, disparity, progress)?;
    if store.pairs().is_empty() {
        progress.warn(&format!(
            "flow contradicts measured depth by more than {} % of the parallax in all {left_out} pairs of frames: depth is not \
             made consistent over time",
            100.0 * FLOW_MISS
        ));
        return Ok(None);
    }
    let small = |value: &dyn Fn(usize) -> f32| {
        let mut plane = Plane::filled(w, h, 0.0f32);
        for y in 0..h {
            for x in 0..w {
                plane[(x, y)] = value(2 * y * clip.width + 2 * x);
            }
        }
        plane
    };
    let frames = clip.cameras.len();
    let (mut start, mut u, mut prior) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..frames {
        let moves = |p: usize| clip.moving[i][p] > 0;
        start.push(small(&|p| disparity[i][p]));
        u.push(small(&|p| uncertainty_of_static(if moves(p) { 0.0 } else { 1.0 })));
        prior.push(small(&|p| {
            if moves(p) { 1.0 } else { PRIOR * clip.confidence[i][p] }
        }));
    }
    let c2w: Vec<Se3<f64>> = clip.cameras.iter().map(|c| c.c2w).collect();
    let input = CvdInput {
        c2w: &c2w,
        intrinsics: clip.cameras[0].intrinsics.resized(w, h),
        disparity: &start,
        uncertainty: &u,
        prior_confidence: Some(&prior),
    };
    let found = optimise(&input, &store, settings, progress, cache)?;
    let factors = (0..frames)
        .map(|i| {
            let ratio: Vec<f32> = found.disparity[i]
                .data()
                .iter()
                .zip(start[i].data())
                .map(|(a, b)| a / b)
                .collect();
            (0..clip.width * clip.height)
                .map(|p| {
                    let (x, y) = ((p % clip.width) as f32 / 2.0, (p / clip.width) as f32 / 2.0);
                    bilinear(w, h, &ratio, x, y)
                })
                .collect()
        })
        .collect();
    Ok(Some(factors))
}

#[cfg(test)]
mod tests {
    use super::{Clip, Flow, FlowPair, factors};
    use crate::cvd::CvdSettings;
    use m4_math::Se3;
    use m4_math::nalgebra::Vector6;
    use m4_scene::{Camera, Intrinsics, NoCache, Progress};
    use std::sync::Mutex;

    const W: usize = 64;
    const H: usize = 48;
    const FRAMES: usize = 4;
    /// The distance of a wall that the camera passes, and how far it comes a frame.
    const DEPTH: f32 = 2.0;
    const STEP: f64 = 0.1;

    #[derive(Default)]
    struct Warnings(Mutex<Vec<String>>);

    impl Progress for Warnings {
        fn update(&self, _: &str, _: usize, _: usize, _: &str) {}
        fn cancelled(&self) -> bool {
            false
        }
        fn warn(&self, message: &str) {
            self.0.lock().unwrap().push(message.to_owned());
        }
    }

    /// The factors where depth is true but in one frame, and flow is `gain` times the true one.
    fn found(gain: f32) -> (Option<Vec<Vec<f32>>>, Vec<String>) {
        let cameras: Vec<Camera> = (0..FRAMES)
            .map(|i| Camera {
                intrinsics: Intrinsics::centred(W, H, 60.0),
                c2w: Se3::identity().retract(&Vector6::new(STEP * i as f64, 0.0, 0.0, 0.0, 0.0, 0.0)),
            })
            .collect();
        let u = gain * 60.0 * STEP as f32 / DEPTH;
        let flow = |u: f32| Flow {
            u: vec![u; W * H],
            ..Flow::zero(W, H)
        };
        let flows: Vec<FlowPair> = (1..FRAMES)
            .map(|_| FlowPair {
                forward: flow(-u),
                backward: flow(u),
                forward_round_trip: vec![0.0; W * H],
                backward_round_trip: vec![0.0; W * H],
            })
            .collect();
        let disparity: Vec<Vec<f32>> = (0..FRAMES)
            .map(|i| vec![if i == 2 { 1.04 } else { 1.0 } / DEPTH; W * H])
            .collect();
        let clip = Clip {
            width: W,
            height: H,
            cameras: &cameras,
            flows: &flows,
            moving: &vec![vec![0; W * H]; FRAMES],
            confidence: &vec![vec![0.6; W * H]; FRAMES],
        };
        let warnings = Warnings::default();
        let found = factors(&clip, &disparity, &CvdSettings::default(), &warnings, &NoCache).unwrap();
        (found, warnings.0.into_inner().unwrap())
    }

    #[test]
    fn flow_draws_the_odd_frame_to_the_others() {
        let (found, warnings) = found(1.0);
        let odd = found.unwrap()[2][(H / 2) * W + W / 2];
        assert!(
            (1.04 * odd - 1.0).abs() < 0.02 && warnings.is_empty(),
            "{odd} {warnings:?}"
        );
    }

    #[test]
    fn flow_that_measured_depth_contradicts_says_nothing() {
        let (found, warnings) = found(1.3);
        assert!(found.is_none());
        assert!(
            warnings.len() == 1 && warnings[0].contains("contradicts measured depth"),
            "{warnings:?}"
        );
    }
}
