//! Static pixels and their flow.

use crate::classical::dense::{FlowPair, ScaledFrame, working_size};
use m4_core::{Capture, CaptureFrame, CompactDepth, Progress};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Flow whose way there and back does not close by this is not used, pixels of the working size.
const ROUND_TRIP_PX: f32 = 0.5;
/// Depth that changes by more than this share from a pixel to the next is an edge, whose place is uncertain.
const EDGE: f32 = 0.05;

/// Longest side at which flow is measured, pixels.
const SIDE_PX: usize = 640;
/// Frames from which flow is measured, evenly spread.
const ANCHORS: usize = 12;
/// How many frames later flow arrives.
const GAPS: [usize; 2] = [1, 6];
/// Pixels of the working size from one sample to the next.
const STRIDE_PX: usize = 5;

/// Why a capture could not be checked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConsistencyError {
    /// The caller asked to stop.
    #[error("stopped on request while flow was measured")]
    Cancelled,
}

/// A pixel of one frame and where it is in another; pixels of the images, measured from their corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub from_px: [f64; 2],
    pub to_px: [f64; 2],
    /// z-depth where it starts and where it arrives, 0 where unknown.
    pub depth: [f64; 2],
}

/// Samples of two frames.
#[derive(Debug)]
pub(super) struct Pair {
    pub frames: [usize; 2],
    pub samples: Vec<Sample>,
}

/// Samples of all pairs, in order: of pixels that rest by the masks, and of pixels that move by them.
#[derive(Debug, Default)]
pub(super) struct Samples {
    pub resting: Vec<Pair>,
    pub moving: Vec<Pair>,
}

/// Takes the samples.
pub(super) fn samples(capture: &Capture, progress: &dyn Progress) -> Result<Samples, ConsistencyError> {
    let n = capture.frames.len();
    let anchors = ANCHORS.clamp(1, n.max(1));
    let mut pairs: Vec<[usize; 2]> = Vec::new();
    for gap in GAPS {
        let room = n.saturating_sub(gap);
        for k in 0..anchors.min(room) {
            let from = k * (room - 1) / (anchors.min(room) - 1).max(1);
            pairs.push([from, from + gap]);
        }
    }
    pairs.retain(|[a, b]| a != b && capture.frames[*a].rgb.size() == capture.frames[*b].rgb.size());
    pairs.sort_unstable();
    pairs.dedup();
    let done = AtomicUsize::new(0);
    let found: Vec<Result<[Pair; 2], ConsistencyError>> = pairs
        .par_iter()
        .map(|&frames| {
            if progress.cancelled() {
                return Err(ConsistencyError::Cancelled);
            }
            let pair = between(capture, frames);
            progress.update("check", done.fetch_add(1, Ordering::Relaxed) + 1, pairs.len(), "");
            Ok(pair)
        })
        .collect();
    let mut out = Samples::default();
    for pair in found {
        let [resting, moving] = pair?;
        out.resting.push(resting);
        out.moving.push(moving);
    }
    Ok(out)
}

fn between(capture: &Capture, frames: [usize; 2]) -> [Pair; 2] {
    let [a, b] = frames.map(|i| &capture.frames[i]);
    let (w, h) = a.rgb.size();
    let (fw, fh) = working_size(w, h, SIDE_PX);
    let [first, second] = [a, b].map(|f| ScaledFrame::new(&f.rgb, (fw, fh)));
    let pair = FlowPair::between(&first, &second);
    let (sx, sy) = (w as f64 / fw as f64, h as f64 / fh as f64);
    let stride = STRIDE_PX;
    let (mut resting, mut moving) = (Vec::new(), Vec::new());
    for y in (stride / 2..fh).step_by(stride) {
        for x in (stride / 2..fw).step_by(stride) {
            let i = y * fw + x;
            if pair.forward_round_trip[i].is_nan() || pair.forward_round_trip[i] > ROUND_TRIP_PX {
                continue;
            }
            let from_px = [(x as f64 + 0.5) * sx, (y as f64 + 0.5) * sy];
            let to = [x as f64 + 0.5 + f64::from(pair.forward.u[i]), y as f64 + 0.5 + f64::from(pair.forward.v[i])];
            let to_px = [to[0] * sx, to[1] * sy];
            let inside = to_px[0] > 0.0 && to_px[0] < w as f64 && to_px[1] > 0.0 && to_px[1] < h as f64;
            let moves = [moves(a, from_px), moves(b, to_px)];
            if inside && moves[0] == moves[1] {
                let depth = [depth_at(a, from_px), depth_at(b, to_px)];
                let sample = Sample { from_px, to_px, depth };
                if moves[0] { &mut moving } else { &mut resting }.push(sample);
            }
        }
    }
    [resting, moving].map(|samples| Pair { frames, samples })
}

/// The pixel of a map of size `(w, h)` under a place in the image.
fn pixel(frame: &CaptureFrame, [u, v]: [f64; 2], (w, h): (usize, usize)) -> (usize, usize) {
    let (pw, ph) = frame.rgb.size();
    let at = |p: f64, image: usize, map: usize| ((p * map as f64 / image as f64) as usize).min(map - 1);
    (at(u, pw, w), at(v, ph, h))
}

fn moves(frame: &CaptureFrame, at_px: [f64; 2]) -> bool {
    frame.mask.as_ref().is_some_and(|mask| {
        let (x, y) = pixel(frame, at_px, mask.size());
        mask.at(x, y)
    })
}

/// 0 where unknown or at an edge.
fn depth_at(frame: &CaptureFrame, at_px: [f64; 2]) -> f64 {
    let read = |depth: &CompactDepth| {
        let (w, h) = depth.size();
        let (x, y) = pixel(frame, at_px, (w, h));
        let z = depth.at(x, y);
        let mut around =
            [(x.saturating_sub(1), y), ((x + 1).min(w - 1), y), (x, y.saturating_sub(1)), (x, (y + 1).min(h - 1))]
                .into_iter();
        let smooth = around.all(|(x, y)| (depth.at(x, y) - z).abs() <= EDGE * z);
        if z > 0.0 && smooth { f64::from(z) } else { 0.0 }
    };
    frame.depth.as_ref().map_or(0.0, read)
}
