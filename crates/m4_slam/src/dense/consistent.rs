//! Depth of what stands still, made to agree over time (consistent video depth, [`crate::cvd`]).
//!
//! Works on planes of half the working size; what comes back is a factor a pixel, so the edges of the working size stay.

use super::config::ConsistentConfig;
use super::error::DenseError;
use super::flow::{Flow, FlowPair, bilinear};
use crate::cvd::pairs::{FlowView, FramePair, PairStore, consistency_mask, pair_list};
use crate::cvd::{CvdError, CvdInput, optimise, uncertainty_of_static};
use m4_math::Se3;
use m4_scene::{Camera, Plane, Progress};

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

/// Flow of every pair of the list, chained from neighbour to neighbour, where it is sure and nothing moves.
fn pairs(clip: &Clip<'_>, config: &ConsistentConfig, progress: &dyn Progress) -> Result<PairStore, DenseError> {
    let (w, h) = (clip.width / 2, clip.height / 2);
    let frames = clip.cameras.len();
    let mut store = PairStore::new(w, h, config.flow_bytes);
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
        store
            .push(FramePair { source, target }, view(&there), &mask)
            .map_err(CvdError::from)?;
    }
    Ok(store)
}

/// Factors on the disparity of every pixel, `[height][width]` by frame.
pub(super) fn factors(
    clip: &Clip<'_>,
    disparity: &[Vec<f32>],
    config: &ConsistentConfig,
    progress: &dyn Progress,
) -> Result<Vec<Vec<f32>>, DenseError> {
    let (w, h) = (clip.width / 2, clip.height / 2);
    let store = pairs(clip, config, progress)?;
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
            if moves(p) {
                1.0
            } else {
                config.prior * clip.confidence[i][p]
            }
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
    let found = optimise(&input, &store, &config.optimiser, progress)?;
    Ok((0..frames)
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
        .collect())
}
