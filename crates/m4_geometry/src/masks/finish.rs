//! What was followed, to masks and a report.

use super::bound::bounded;
use super::coarse::{Coarse, CoarseMasks};
use super::error::InstanceError;
use super::ledger::TrackedObject;
use super::outline::Outline;
use super::paint;
use super::polarity::PolarityEvidence;
use super::propose::{Around, PERSISTENT_IN, proposals};
use super::refine::{MERGE_OVERLAP, Refined, RefinedFrame, Refusal};
use super::report::{InstanceReport, Rejection};
use super::source::ObjectId;
use m4_core::{CompactIds, CompactMask, Progress};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Share of a thing's pixels that must be coarse for a frame to support it.
const SUPPORT: f64 = 0.25;
/// In what share of its frames a thing must be supported by coarse pixels: what was taken for dynamic for a moment and never again is
/// dropped. Not in the paper, which has 0.
const LEAST_SUPPORT: f32 = 0.1;
/// Holes of the masks up to this share of the image are filled.
const HOLE_SHARE: f32 = 0.001;
/// What is done, for messages.
const PHASE: &str = "painting instances";

/// `segmenter`: its name, and how far from coarse pixels its masks may reach.
pub(super) fn finish(
    rough: &CoarseMasks<'_>,
    frames: usize,
    (segmenter, bound): (&str, Option<f32>),
    things: BTreeMap<ObjectId, TrackedObject>,
    mut refused: Vec<Refusal>,
    polarity: Option<PolarityEvidence>,
    progress: &dyn Progress,
) -> Result<Refined, InstanceError> {
    let (w, h) = rough.size;
    let (things, now) = merged(things, rough.size);
    let support = support(rough, &things, frames, progress)?;
    let things = match bound {
        Some(share) => bounded(rough, things, frames, share, progress)?,
        None => things,
    };
    let mut kept: Vec<(u16, &TrackedObject, f64)> = Vec::new();
    let mut ids: BTreeMap<ObjectId, u16> = BTreeMap::new();
    for (thing, &share) in things.iter().zip(&support) {
        if share < f64::from(LEAST_SUPPORT) || thing.masks.is_empty() {
            refused.push(Refusal {
                frame: thing.prompted,
                area: thing.part_area,
                centre_px: thing.part_centre_px,
                reason: Rejection::Unsupported { share },
                of: None,
            });
            continue;
        }
        let id = kept.len() as u16 + 1;
        ids.insert(thing.object, id);
        kept.push((id, thing, share));
    }
    for refusal in &mut refused {
        refusal.of = refusal.of.map(|object| now.get(&object).copied().unwrap_or(object));
    }
    refused.sort_by_key(|r| r.frame);

    let done = AtomicUsize::new(0);
    let painted: Vec<Painted> = (0..frames)
        .into_par_iter()
        .map(|frame| {
            if progress.cancelled() {
                return Err(InstanceError::Cancelled { phase: PHASE });
            }
            let shown: Vec<(u16, &Outline)> = kept
                .iter()
                .filter_map(|(id, thing, _)| Some((*id, thing.masks.get(&frame)?)))
                .collect();
            let out = paint_frame(rough, frame, frames, &shown);
            progress.update(PHASE, done.fetch_add(1, Ordering::Relaxed) + 1, frames, "");
            Ok(out)
        })
        .collect::<Result<_, _>>()?;

    let pixels = w * h;
    let share =
        |of: &dyn Fn(&Painted) -> usize| painted.iter().map(of).sum::<usize>() as f64 / (pixels * frames).max(1) as f64;
    let record = |&(id, thing, supported): &(u16, &TrackedObject, f64)| thing.record(id, supported, pixels, frames);
    let report = InstanceReport {
        segmenter: segmenter.to_owned(),
        coarse: rough.coarse.name().to_owned(),
        polarity,
        frames,
        size: [w, h],
        every_frames: rough.settings.every_frames,
        coarse_share: share(&|p| p.coarse_px),
        refined_share: share(&|p| p.frame.mask.count()),
        unexplained_share: share(&|p| p.unexplained_px),
        instances: kept.iter().filter_map(record).collect(),
        rejected: refused.iter().map(|r| r.to_report(pixels, &ids)).collect(),
    };
    Ok(Refined {
        frames: painted.into_iter().map(|p| p.frame).collect(),
        report,
    })
}

/// Things that are one, made one, in the order in which they were found; and what became of those that were taken in.
fn merged(
    things: BTreeMap<ObjectId, TrackedObject>,
    size: (usize, usize),
) -> (Vec<TrackedObject>, BTreeMap<ObjectId, ObjectId>) {
    let mut out: Vec<TrackedObject> = Vec::new();
    let mut now = BTreeMap::new();
    for thing in things.into_values() {
        match out.iter_mut().find(|other| other.is_also(&thing, MERGE_OVERLAP)) {
            Some(other) => {
                now.insert(thing.object, other.object);
                other.absorb(thing, size);
            }
            None => out.push(thing),
        }
    }
    (out, now)
}

/// For each thing the share of its frames in which it has coarse pixels.
fn support(
    rough: &CoarseMasks<'_>,
    things: &[TrackedObject],
    frames: usize,
    progress: &dyn Progress,
) -> Result<Vec<f64>, InstanceError> {
    let width = rough.size.0;
    let of_frame = |frame: usize| {
        if progress.cancelled() {
            return Err(InstanceError::Cancelled { phase: PHASE });
        }
        let shown: Vec<Option<&Outline>> = things.iter().map(|thing| thing.masks.get(&frame)).collect();
        if shown.iter().all(Option::is_none) {
            return Ok(vec![false; things.len()]);
        }
        let coarse = rough.at(frame).raw;
        let backed = |outline: &Outline| {
            let there = outline.pixels().filter(|(x, y)| coarse[y * width + x] > 0).count();
            there as f64 >= SUPPORT * outline.area() as f64
        };
        Ok(shown.into_iter().map(|outline| outline.is_some_and(backed)).collect())
    };
    let by_frame: Vec<Vec<bool>> = (0..frames).into_par_iter().map(of_frame).collect::<Result<_, _>>()?;
    let share = |(k, thing): (usize, &TrackedObject)| {
        let backed = by_frame.iter().filter(|frame| frame[k]).count();
        backed as f64 / thing.masks.len().max(1) as f64
    };
    Ok(things.iter().enumerate().map(share).collect())
}

struct Painted {
    frame: RefinedFrame,
    coarse_px: usize,
    unexplained_px: usize,
}

fn paint_frame(rough: &CoarseMasks<'_>, frame: usize, frames: usize, shown: &[(u16, &Outline)]) -> Painted {
    let (w, h) = rough.size;
    let mut ids = paint::ids(shown, rough.size);
    paint::fill_holes(&mut ids, (HOLE_SHARE * (w * h) as f32) as usize);
    let mut mask: Vec<u8> = ids.data().iter().map(|&id| if id > 0 { 255 } else { 0 }).collect();
    let mut unexplained_px = 0;
    // Coarse parts that no thing explains stay in masks, which found them with more care than maps of motion do (the paper drops them).
    let coarse = if matches!(rough.coarse, Coarse::Masks(_)) {
        let around = Around::of(rough, frame, frames);
        for part in proposals(rough, &around, &mask) {
            if part.seen_in >= PERSISTENT_IN {
                unexplained_px += part.outline.area();
                for (x, y) in part.outline.pixels() {
                    mask[y * w + x] = 255;
                }
            }
        }
        around.here.raw
    } else {
        rough.at(frame).raw
    };
    Painted {
        frame: RefinedFrame {
            mask: CompactMask::from_fn(w, h, |x, y| mask[y * w + x] > 0),
            ids: CompactIds::from(&ids),
        },
        coarse_px: coarse.iter().filter(|&&m| m > 0).count(),
        unexplained_px,
    }
}
