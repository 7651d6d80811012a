//! Bounds masks to the neighbourhood of moving pixels.

use super::coarse::CoarseMasks;
use super::error::InstanceError;
use super::ledger::TrackedObject;
use super::morphology::dilated;
use super::outline::Outline;
use m4_core::{CompactMask, Progress};
use rayon::prelude::*;

/// Of a mask that is cut back to less than this, what is left is of something else.
const LEAST_LEFT: f64 = 0.25;
/// What is done, for messages.
const PHASE: &str = "holding masks to motion";

/// Frames without coarse pixels on a thing that are bridged: it may rest, or the coarse masks miss it.
const BRIDGE: usize = 5;

/// Cuts the masks of all things to what lies within `share` of the longest side around coarse pixels of the same frame. Where too little
/// of one is left, it stays as it was followed in frames near one where enough is, and is dropped farther away.
pub(super) fn bounded(
    rough: &CoarseMasks<'_>,
    things: Vec<TrackedObject>,
    frames: usize,
    share: f32,
    progress: &dyn Progress,
) -> Result<Vec<TrackedObject>, InstanceError> {
    let (w, h) = rough.size;
    let radius_px = share * w.max(h) as f32;
    let of_frame = |frame: usize| {
        if progress.cancelled() {
            return Err(InstanceError::Cancelled { phase: PHASE });
        }
        let shown: Vec<Option<&Outline>> = things.iter().map(|thing| thing.masks.get(&frame)).collect();
        if shown.iter().all(Option::is_none) {
            return Ok(vec![None; things.len()]);
        }
        let near = dilated(w, h, &rough.at(frame).raw, radius_px);
        let within = |outline: &Outline| {
            let mask = CompactMask::from_fn(w, h, |x, y| near[y * w + x] > 0 && outline.at(x, y));
            Outline::of(&mask).filter(|left| left.area() as f64 >= LEAST_LEFT * outline.area() as f64)
        };
        Ok(shown.into_iter().map(|outline| within(outline?)).collect())
    };
    let mut cut: Vec<Vec<Option<Outline>>> = (0..frames).into_par_iter().map(of_frame).collect::<Result<_, _>>()?;
    let held = |(k, mut thing): (usize, TrackedObject)| {
        let backed: Vec<bool> = cut.iter().map(|frame| frame[k].is_some()).collect();
        thing.masks.retain(|&frame, _| {
            let near = frame.saturating_sub(BRIDGE)..(frame + BRIDGE + 1).min(frames);
            backed[near].iter().any(|&b| b)
        });
        for (&frame, mask) in &mut thing.masks {
            if let Some(left) = cut[frame][k].take() {
                *mask = left;
            }
        }
        thing
    };
    Ok(things.into_iter().enumerate().map(held).collect())
}

#[cfg(test)]
mod tests {
    use super::bounded;
    use crate::masks::coarse::{Coarse, CoarseMasks};
    use crate::masks::ledger::TrackedObject;
    use crate::masks::outline::Outline;
    use crate::masks::{ObjectId, RefineSettings};
    use m4_core::{CompactMask, Silent};

    #[test]
    fn spreading_masks_are_cut_and_stray_ones_dropped() {
        let size = (64, 48);
        let block = |x0: usize, x1: usize| {
            CompactMask::from_fn(64, 48, move |x, y| (x0..x1).contains(&x) && (10..30).contains(&y))
        };
        // it moves through three frames and out of the image; the coarse masks miss it once
        let nothing = block(0, 0);
        let mut coarse = vec![block(10, 20), nothing.clone(), block(30, 40)];
        coarse.resize(12, nothing);
        let coarse = Coarse::Masks(coarse.iter().collect());
        let settings = RefineSettings::default();
        let rough = CoarseMasks {
            coarse: &coarse,
            size,
            settings: &settings,
        };
        // as it is; as it is; grown along a wall; then it sticks to that wall
        let mut masks = vec![block(10, 20), block(20, 30), block(30, 55)];
        masks.resize(12, block(45, 55));
        let masks = masks.iter().map(Outline::of).map(Option::unwrap).enumerate().collect();
        let thing = TrackedObject {
            object: ObjectId(7),
            prompted: 0,
            overlap: 1.0,
            quality: None,
            coarse_outline: false,
            part_area: 200,
            part_centre_px: [15.0, 20.0],
            masks,
            overgrown: 0,
            lost: [false; 2],
            found_again: Vec::new(),
        };
        let held = bounded(&rough, vec![thing], 12, 2.0 / 64.0, &Silent).unwrap();
        let held = &held[0].masks;
        assert_eq!(held.keys().copied().collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5, 6, 7]);
        assert_eq!((held[&0].area(), held[&1].area()), (200, 200));
        let columns: Vec<usize> = held[&2].pixels().map(|(x, _)| x).collect();
        let right = columns.iter().copied().max().unwrap();
        assert!(
            (40..=42).contains(&right) && columns.iter().min() == Some(&30),
            "{right}"
        );
    }
}
