//! Finds dynamic pixels: flow that the camera and the depth do not explain.

use super::background_model::difference_evidence;
use super::flow::{FlowPair, ScaledFrame};
use super::regions::clean;
use super::shot::{Pair, Shot};
use super::smooth::{Smoother, box_blur};
use super::working::{nearest_pixel, observed};
use crate::classical::{Motion, SparseReconstruction};
use fearless_simd::Level;
use m4_core::{Camera, Flow, bilinear, dispatch, quantile};

/// Over how many frames flow is chained and compared, each both ways: the short span for fast motion, the long one for slow motion.
const SPANS: [usize; 2] = [1, 4];
/// Noise of the flow, pixels at the working size.
const FLOW_NOISE_PX: f32 = 0.4;
/// Noise of the flow that grows with its length, as a share of it.
const FLOW_NOISE_SHARE: f32 = 0.05;
/// Residual at which a pixel is as likely dynamic as static, in units of the noise. The specification's 3 MAD are 2 standard
/// deviations.
pub(super) const THRESHOLD: f32 = 2.5;
/// Strength of a vote for static against one for dynamic, 0..1: motion that one span alone can see outvotes the rest.
pub(super) const STATIC_VOTE: f32 = 0.5;
/// Difference in brightness (0..255, mean of 5x5 pixels) between a pixel and its static place in the other frame that clearly
/// refutes that it is static.
const BRIGHTNESS_STEP: f32 = 6.0;
/// Least weight of flow that calls a pixel dynamic although its brightness fits a static one, 0..1.
const LEAST_REFUTED: f32 = 0.1;
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

/// Flow that leads from a frame to another.
struct Link {
    there: Flow,
    /// `[height][width]`: how far the way there and back misses, pixels, added up over the steps.
    round_trip: Vec<f32>,
    pair: Pair,
}

/// What is known of the clip as a whole.
pub(super) struct MotionCues {
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
pub(super) fn verdicts(sparse: &SparseReconstruction, width: usize, height: usize) -> Vec<Vec<(usize, bool)>> {
    let mut out = vec![Vec::new(); sparse.cameras.len()];
    for (frame, pixel, track) in observed(sparse, width, height).filter(|(.., t)| t.motion != Motion::Unknown) {
        out[frame].push((pixel, track.motion == Motion::Dynamic));
    }
    out
}

/// The flow from frame `i` over `span` frames, by chaining; `None` past the end of the clip.
fn link(flows: &[FlowPair], cameras: &[Camera], i: usize, span: usize, later: bool) -> Option<Link> {
    let target = if later { i + span } else { i.checked_sub(span)? };
    let to = cameras.get(target)?;
    let step = |k: usize| FlowPair::step(flows, if later { i + k } else { i - k }, later);
    let (first, trip) = step(0)?;
    let (mut there, mut round_trip) = (first.clone(), trip.to_vec());
    let (w, h) = (there.width, there.height);
    for k in 1..span {
        let (flow, trip) = step(k)?;
        for p in 0..w * h {
            let (x, y) = ((p % w) as f32 + there.u[p], (p / w) as f32 + there.v[p]);
            let (u, v) = flow.at(x, y);
            there.u[p] += u;
            there.v[p] += v;
            round_trip[p] += trip[nearest_pixel(w, h, x, y)];
        }
    }
    Some(Link { there, round_trip, pair: Pair::new(&cameras[i], to) })
}

/// Evidence of one frame, below 0 for static and above for moving, smoothed along the edges of the frame:
/// flow against what depth and cameras predict, agreement of the partners, verdicts of tracks, and, where
/// the camera is static, the difference to the background.
pub(super) fn evidence(
    clues: &MotionCues,
    shots: &[Shot],
    flows: &[FlowPair],
    i: usize,
    seen: &FrameDisparity<'_>,
    smoother: &Smoother,
) -> Vec<f32> {
    let (w, h) = (seen.frame.width, seen.frame.height);
    let (mut value, mut weight) = (vec![-PRIOR * STATIC_VOTE; w * h], vec![PRIOR; w * h]);
    for span in SPANS {
        for later in [false, true] {
            if let Some(link) = link(flows, &clues.cameras, i, span, later) {
                let other = &shots[if later { i + span } else { i - span }].frame.grey;
                let refuted = refuted(&seen.frame.grey, other, &link, seen.disparity);
                add_link(&link, seen.disparity, &refuted, &mut value, &mut weight);
            }
        }
    }
    for p in 0..w * h {
        let agreement = AGREEMENT * seen.confidence[p] * seen.confidence[p];
        value[p] -= agreement;
        weight[p] += agreement;
    }
    if let Some(background) = &clues.background {
        for ((v, w), e) in value.iter_mut().zip(&mut weight).zip(difference_evidence(background, seen.frame)) {
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

/// How clearly the image says that a pixel is not where it would be if it stood still, 0..1: on a
/// flat wall flow is a guess, and a pixel that looks the same at its static place need not have moved.
fn refuted(grey: &[f32], other: &[f32], link: &Link, disparity: &[f32]) -> Vec<f32> {
    let (w, h) = (link.there.width, link.there.height);
    let mut out: Vec<f32> = (0..w * h)
        .map(|i| {
            let seen = link.pair.project((i % w) as f32, (i / w) as f32, disparity[i]);
            (bilinear(w, h, other, seen.x, seen.y) - grey[i]).abs()
        })
        .collect();
    box_blur(w, h, &mut out);
    for v in &mut out {
        *v = (*v / BRIGHTNESS_STEP).clamp(LEAST_REFUTED, 1.0);
    }
    out
}

fn add_link(link: &Link, disparity: &[f32], refuted: &[f32], value: &mut [f32], weight: &mut [f32]) {
    let width = link.there.width;
    // Distance between where the flow and where the geometry says a pixel went; NaN for no answer.
    let residual: Vec<f32> = (0..disparity.len())
        .map(|i| {
            let (x, y) = ((i % width) as f32, (i / width) as f32);
            let seen = link.pair.project(x, y, disparity[i]);
            if seen.disparity > 0.0 && link.round_trip[i].is_finite() {
                (x + link.there.u[i] - seen.x).hypot(y + link.there.v[i] - seen.y)
            } else {
                f32::NAN
            }
        })
        .collect();
    // Most of a frame is static, so what half of it exceeds is error of the cameras.
    let mut known: Vec<f32> = residual.iter().copied().filter(|r| r.is_finite()).collect();
    let floor = FLOW_NOISE_PX.max(quantile(&mut known, 0.5).unwrap_or(0.0));
    for i in (0..disparity.len()).filter(|&i| residual[i].is_finite()) {
        let (u, v, trip) = (link.there.u[i], link.there.v[i], link.round_trip[i]);
        let noise = floor + FLOW_NOISE_SHARE * u.hypot(v) + 0.5 * trip;
        let e = (0.5 * (residual[i] / noise - THRESHOLD)).clamp(-STATIC_VOTE, 1.0);
        let w = 1.0 / (1.0 + trip * trip) * if e > 0.0 { refuted[i] } else { 1.0 };
        value[i] += w * e;
        weight[i] += w;
    }
}

/// A track speaks for its surroundings.
fn add_verdict((pixel, moves): (usize, bool), w: usize, h: usize, value: &mut [f32], weight: &mut [f32]) {
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

/// Averages evidence with that of the frames before and after, along the flow where its round trip closes.
pub(super) fn vote(width: usize, height: usize, evidence: &[Vec<f32>], flows: &[FlowPair], i: usize) -> Vec<f32> {
    let (mut sum, mut weight) = (evidence[i].clone(), vec![1.0f32; width * height]);
    // the frame before adds after the frame that follows
    for later in [true, false] {
        if let Some((flow, trip)) = FlowPair::step(flows, i, later) {
            let other = &evidence[if later { i + 1 } else { i - 1 }];
            // compiled for each set of vector instructions; the arithmetic is the same on all
            dispatch!(Level::new(), _s => add_votes([width, height], flow, trip, other, &mut sum, &mut weight));
        }
    }
    sum.iter().zip(&weight).map(|(sum, weight)| sum / weight).collect()
}

/// Adds the evidence of the frame that `flow` leads to, by how well its round trip closes.
#[inline(always)]
fn add_votes(
    [width, height]: [usize; 2],
    flow: &Flow,
    trip: &[f32],
    other: &[f32],
    sum: &mut [f32],
    weight: &mut [f32],
) {
    /// Least weight that counts.
    const LEAST: f32 = 0.1;
    let (right, bottom) = (width as i32 - 1, height as i32 - 1);
    let mut pixels = vec![0i32; width];
    for y in 0..height {
        let row = y * width..(y + 1) * width;
        for (x, (pixel, (u, v))) in
            pixels.iter_mut().zip(flow.u[row.clone()].iter().zip(&flow.v[row.clone()])).enumerate()
        {
            let (x, y) = ((x as f32 + u + 0.5) as i32, (y as f32 + v + 0.5) as i32);
            *pixel = y.clamp(0, bottom) * width as i32 + x.clamp(0, right);
        }
        let sums = sum[row.clone()].iter_mut().zip(&mut weight[row.clone()]);
        for ((sum, weight), (pixel, trip)) in sums.zip(pixels.iter().zip(&trip[row])) {
            let close = 1.0 / (1.0 + trip * trip);
            let close = if close >= LEAST { close } else { 0.0 };
            *sum += close * other.get(*pixel as usize).copied().unwrap_or(0.0);
            *weight += close;
        }
    }
}

/// Where evidence is above 0, without specks and pinholes.
pub(super) fn mask(width: usize, height: usize, evidence: &[f32]) -> Vec<u8> {
    let mut mask: Vec<u8> = evidence.iter().map(|&e| if e > 0.0 { 255 } else { 0 }).collect();
    let least = (LEAST_COMPONENT * (width * height) as f32).ceil() as usize;
    clean(width, height, &mut mask, least);
    mask
}
