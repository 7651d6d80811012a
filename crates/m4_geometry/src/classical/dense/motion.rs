//! Finds dynamic pixels: flow that the camera and the depth do not explain.

use super::background_model::difference_evidence;
use super::regions::clean;
use super::shot::Shot;
use super::temporal;
use super::trajectories::Trajectories;
use super::working::observed;
use crate::FrameRate;
use crate::classical::{Motion, SparseReconstruction};
use crate::flow::{FlowPair, ScaledFrame};
use crate::smooth::Smoother;
use m4_core::Camera;

/// Standard deviation of a disparity on which all partners agree, and what none adds, in steps of
/// the sweep.
const SURE_STEPS: f32 = 1.0;
const UNSURE_STEPS: f32 = 10.0;
/// Strength of the edge-aware smoothing of evidence, pixels squared (Min et al. 2014, lambda).
const SMOOTH_LAMBDA: f32 = 100.0;
/// Evidence for static of a pixel on which all partners agree, 0..1.
const AGREEMENT: f32 = 1.0;
/// Weight of the prior that an unknown pixel is static; the flow between two frames has 1.
const PRIOR: f32 = 0.3;
/// Weight of a track's verdict; the flow between two frames has 1.
const TRACK_WEIGHT: f32 = 3.0;
/// Components below this share of the image are dropped. Specification: 0.2 %.
const LEAST_COMPONENT: f32 = 0.002;

/// What is known of the clip as a whole.
pub(super) struct MotionCues {
    pub rate: FrameRate,
    /// At the working size, one per frame.
    pub cameras: Vec<Camera>,
    /// By frame: pixels of tracks and whether these are dynamic.
    pub verdicts: Vec<Vec<(usize, bool)>>,
    /// The usual colours, for a static camera.
    pub background: Option<Vec<[u8; 3]>>,
}

/// The disparity of one frame.
pub(super) struct FrameDisparity<'a> {
    pub frame: &'a ScaledFrame,
    /// `[height][width]`: of all pixels, assumed static.
    pub disparity: &'a [f32],
    /// `[height][width]`: share of the partners that agree on it.
    pub confidence: &'a [f32],
}

/// The verdicts of all tracks, by frame.
pub(super) fn verdicts(
    sparse: &SparseReconstruction,
    width: usize,
    height: usize,
) -> Vec<Vec<(usize, bool)>> {
    let mut out = vec![Vec::new(); sparse.cameras.len()];
    for (frame, pixel, track) in
        observed(sparse, width, height).filter(|(.., t)| t.motion != Motion::Unknown)
    {
        out[frame].push((pixel, track.motion == Motion::Dynamic));
    }
    out
}

/// Evidence of one frame, below 0 for static and above for moving, smoothed along the edges of the
/// frame: flow against what depth and cameras predict, agreement of the partners, verdicts of
/// tracks, and, where the camera is static, the difference to the background.
pub(super) fn evidence(
    clues: &MotionCues,
    shots: &[Shot],
    flows: &[FlowPair],
    i: usize,
    frame_disparity: &FrameDisparity<'_>,
    smoother: &Smoother,
) -> Vec<f32> {
    let (w, h) = (frame_disparity.frame.width, frame_disparity.frame.height);
    let (mut value, mut weight) = (vec![-PRIOR; w * h], vec![PRIOR; w * h]);
    let deviation: Vec<f32> = frame_disparity
        .confidence
        .iter()
        .map(|c| shots[i].range.step * (SURE_STEPS + UNSURE_STEPS * (1.0 - c)))
        .collect();
    let trajectories = Trajectories {
        shots,
        cameras: &clues.cameras,
        flows,
        rate: clues.rate,
        disparity: frame_disparity.disparity,
        deviation: &deviation,
    };
    for (p, verdict) in trajectories.verdicts(i) {
        value[p] += verdict.weight * verdict.dynamic;
        weight[p] += verdict.weight;
    }
    for p in 0..w * h {
        let agreement = AGREEMENT * frame_disparity.confidence[p] * frame_disparity.confidence[p];
        value[p] -= agreement;
        weight[p] += agreement;
    }
    if let Some(background) = &clues.background {
        for ((v, w), e) in value
            .iter_mut()
            .zip(&mut weight)
            .zip(difference_evidence(background, frame_disparity.frame))
        {
            (*v, *w) = (*v + e, *w + 1.0);
        }
    }
    for &verdict in &clues.verdicts[i] {
        add_verdict(verdict, w, h, &mut value, &mut weight);
    }
    for (v, w) in value.iter_mut().zip(&weight) {
        *v /= w;
    }
    smoother.fill(&value, &weight, SMOOTH_LAMBDA).0
}

/// A track speaks for its surroundings.
fn add_verdict(
    (pixel, moves): (usize, bool),
    w: usize,
    h: usize,
    value: &mut [f32],
    weight: &mut [f32],
) {
    const REACH: usize = 3;
    let (x, y) = (pixel % w, pixel / w);
    for ny in y.saturating_sub(REACH)..(y + REACH + 1).min(h) {
        for nx in x.saturating_sub(REACH)..(x + REACH + 1).min(w) {
            let square = (nx.abs_diff(x).pow(2) + ny.abs_diff(y).pow(2)) as f32;
            let near = TRACK_WEIGHT * (-square / 4.0).exp();
            value[ny * w + nx] += if moves { near } else { -near };
            weight[ny * w + nx] += near;
        }
    }
}

/// How far evidence holds along a step of the flow, 0..1.
pub(super) fn trust(step: &temporal::Step) -> f32 {
    /// Least that counts.
    const LEAST: f32 = 0.1;
    let close = 1.0 / (1.0 + step.round_trip_px * step.round_trip_px);
    if close >= LEAST { close } else { 0.0 }
}

/// Where evidence is above 0, without specks and pinholes.
pub(super) fn mask(width: usize, height: usize, evidence: &[f32]) -> Vec<u8> {
    let mut mask: Vec<u8> = evidence
        .iter()
        .map(|&e| if e > 0.0 { 255 } else { 0 })
        .collect();
    let least = (LEAST_COMPONENT * (width * height) as f32).ceil() as usize;
    clean(width, height, &mut mask, least);
    mask
}
