//! Flow of the pairs of frames that depth is made consistent along.

use super::MegasamError;
use crate::classical::dense::{FlowSource, ScaledFrame};
use crate::megasam::cvd::pairs::{FramePair, PairStore, consistency_mask, halved, pair_list};
use m4_core::{Flow, Progress, RgbImage};

/// Why a pair has no flow.
#[derive(Debug, thiserror::Error)]
#[error("there is no flow from frame {source_frame} to frame {target_frame}: {reason}")]
pub struct PairFlowError {
    /// Where it would start.
    pub source_frame: usize,
    /// Where it would lead.
    pub target_frame: usize,
    /// What went wrong.
    pub reason: Box<dyn std::error::Error + Send + Sync>,
}

/// Measures flow between two frames of a clip. Pairs are asked for by step and then by source ([`pair_list`]), so that a
/// network can begin with what it found for a shorter step.
pub trait PairFlow {
    /// For records and messages.
    fn name(&self) -> &str;

    /// The flow of `pair` and that back, of the size of the images `a` (of the source) and `b`.
    ///
    /// # Errors
    ///
    /// [`PairFlowError`] where it cannot be had.
    fn both(&mut self, pair: FramePair, a: &RgbImage, b: &RgbImage) -> Result<[Flow; 2], PairFlowError>;
}

/// A source of flow that looks at each pair anew.
pub struct SourceFlow<'a>(pub &'a dyn FlowSource);

impl PairFlow for SourceFlow<'_> {
    fn name(&self) -> &str {
        self.0.name()
    }

    fn both(&mut self, pair: FramePair, a: &RgbImage, b: &RgbImage) -> Result<[Flow; 2], PairFlowError> {
        let [from, to] = [a, b].map(|image| ScaledFrame::new(image, image.size()));
        let failed =
            |error| PairFlowError { source_frame: pair.source, target_frame: pair.target, reason: Box::new(error) };
        let there = self.0.both(&from.flow_image(), &to.flow_image());
        let (there, back) = there.map_err(failed)?;
        Ok([there, back])
    }
}

const PHASE: &str = "flow between frames";

/// The flow of every pair at half the size of the images, with the pixels that return to where they started; `budget_bytes`
/// of it stay in memory.
///
/// # Errors
///
/// [`MegasamError`] where flow cannot be had or kept, or the user stops.
pub(super) fn measure(
    frames: usize,
    image_of: &dyn Fn(usize) -> RgbImage,
    size: (usize, usize),
    flow: &mut dyn PairFlow,
    budget_bytes: usize,
    progress: &dyn Progress,
) -> Result<PairStore, MegasamError> {
    let (width, height) = (size.0 / 2, size.1 / 2);
    let mut store = PairStore::new(width, height, budget_bytes);
    let pairs = pair_list(frames);
    let mut last: Option<(usize, RgbImage)> = None;
    for (done, &pair) in pairs.iter().enumerate() {
        if progress.cancelled() {
            return Err(MegasamError::Cancelled);
        }
        let a = match last.take() {
            Some((frame, image)) if frame == pair.source => image,
            _ => image_of(pair.source),
        };
        let b = image_of(pair.target);
        let [there, back] = flow.both(pair, &a, &b)?;
        let [there, back] = [there, back].map(|flow| halved(&flow));
        let mask = consistency_mask(&there, &back);
        store.push(pair, &there, &mask)?;
        // The next pair of the shortest step begins here.
        last = Some((pair.target, b));
        progress.update(PHASE, done + 1, pairs.len(), flow.name());
    }
    Ok(store)
}
