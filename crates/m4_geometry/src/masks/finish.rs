//! Tracked objects to masks and a report: masks are bound to the neighbourhood of dynamic pixels
//! and painted into one map of numbers per frame.

use super::InstanceError;
use super::coarse::{Around, PERSISTENT_IN, proposals};
use super::coarse::{Coarse, CoarseMasks, dilated};
use super::ledger::{Outline, TrackedObject};
use super::refine::{MERGE_OVERLAP, Refined, RefinedFrame};
use super::source::ObjectId;
use super::{InstanceReport, Rejected, Rejection};
use crate::classical::dense::Components;
use m4_core::{CompactIds, CompactMask, Plane, Progress};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Share of a thing's pixels that must be coarse for a frame to support it.
const SUPPORT: f64 = 0.25;
/// In what share of its frames a thing must be supported by coarse pixels: what was taken for
/// dynamic for a moment and never again is dropped. Not in the paper, which has 0.
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
    mut rejected: Vec<Rejected>,
    progress: &dyn Progress,
) -> Result<Refined, InstanceError> {
    let (w, h) = rough.size;
    let pixels = w * h;
    let things = merged(things, rough.size);
    let support = support(rough, &things, frames, progress)?;
    let things = match bound {
        Some(share) => bounded(rough, things, frames, share, progress)?,
        None => things,
    };
    let mut objects: Vec<(u16, &TrackedObject, f64)> = Vec::new();
    for (thing, &share) in things.iter().zip(&support) {
        if share < f64::from(LEAST_SUPPORT) || thing.masks.is_empty() {
            rejected.push(Rejected {
                frame: thing.prompted,
                area_share: thing.part_area as f64 / pixels.max(1) as f64,
                centre_px: thing.part_centre_px,
                reason: Rejection::Unsupported { share },
            });
            continue;
        }
        objects.push((objects.len() as u16 + 1, thing, share));
    }
    rejected.sort_by_key(|r| r.frame);

    let done = AtomicUsize::new(0);
    let painted: Vec<Painted> = (0..frames)
        .into_par_iter()
        .map(|frame| {
            if progress.cancelled() {
                return Err(InstanceError::Cancelled { phase: PHASE });
            }
            let shown: Vec<(u16, &Outline)> = objects
                .iter()
                .filter_map(|(id, thing, _)| Some((*id, thing.masks.get(&frame)?)))
                .collect();
            let out = paint_frame(rough, frame, frames, &shown);
            progress.update(PHASE, done.fetch_add(1, Ordering::Relaxed) + 1, frames, "");
            Ok(out)
        })
        .collect::<Result<_, _>>()?;

    let share = |of: &dyn Fn(&Painted) -> usize| {
        painted.iter().map(of).sum::<usize>() as f64 / (pixels * frames).max(1) as f64
    };
    let record = |&(id, thing, supported): &(u16, &TrackedObject, f64)| {
        thing.record(id, supported, pixels, frames)
    };
    let report = InstanceReport {
        segmenter: segmenter.to_owned(),
        coarse: rough.coarse.name().to_owned(),
        frames,
        size: [w, h],
        every_frames: rough.settings.every_frames,
        coarse_share: share(&|p| p.coarse_px),
        refined_share: share(&|p| p.frame.mask.count()),
        unexplained_share: share(&|p| p.unexplained_px),
        instances: objects.iter().filter_map(record).collect(),
        rejected,
    };
    Ok(Refined {
        frames: painted.into_iter().map(|p| p.frame).collect(),
        report,
    })
}

/// Things that are one, made one, in the order in which they were found.
fn merged(things: BTreeMap<ObjectId, TrackedObject>, size: (usize, usize)) -> Vec<TrackedObject> {
    let mut out: Vec<TrackedObject> = Vec::new();
    for thing in things.into_values() {
        match out
            .iter_mut()
            .find(|other| other.is_also(&thing, MERGE_OVERLAP))
        {
            Some(other) => other.absorb(thing, size),
            None => out.push(thing),
        }
    }
    out
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
        let shown: Vec<Option<&Outline>> =
            things.iter().map(|thing| thing.masks.get(&frame)).collect();
        if shown.iter().all(Option::is_none) {
            return Ok(vec![false; things.len()]);
        }
        let coarse = rough.at(frame).raw;
        let backed = |outline: &Outline| {
            let overlap = outline
                .pixels()
                .filter(|(x, y)| coarse[y * width + x] > 0)
                .count();
            overlap as f64 >= SUPPORT * outline.area() as f64
        };
        Ok(shown
            .into_iter()
            .map(|outline| outline.is_some_and(backed))
            .collect())
    };
    let by_frame: Vec<Vec<bool>> = (0..frames)
        .into_par_iter()
        .map(of_frame)
        .collect::<Result<_, _>>()?;
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

fn paint_frame(
    rough: &CoarseMasks<'_>,
    frame: usize,
    frames: usize,
    shown: &[(u16, &Outline)],
) -> Painted {
    let (w, h) = rough.size;
    let mut ids = painted_ids(shown, rough.size);
    fill_holes(&mut ids, (HOLE_SHARE * (w * h) as f32) as usize);
    let mut mask: Vec<u8> = ids
        .data()
        .iter()
        .map(|&id| if id > 0 { 255 } else { 0 })
        .collect();
    let mut unexplained_px = 0;
    // Coarse parts that no thing explains stay in masks, which found them with more care than maps
    // of motion do (the paper drops them).
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

/// Of a mask that is cut back to less than this, what is left is of something else.
const LEAST_LEFT: f64 = 0.25;
/// What is done, for messages.
const BOUND_PHASE: &str = "holding masks to motion";

/// Frames without coarse pixels on a thing that are bridged: it may rest, or the coarse masks miss
/// it.
const BRIDGE: usize = 5;

/// Cuts the masks of all things to what lies within `share` of the longest side around coarse
/// pixels of the same frame. Where too little of one is left, it stays as it was followed in frames
/// near one where enough is, and is dropped farther away.
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
            return Err(InstanceError::Cancelled { phase: BOUND_PHASE });
        }
        let shown: Vec<Option<&Outline>> =
            things.iter().map(|thing| thing.masks.get(&frame)).collect();
        if shown.iter().all(Option::is_none) {
            return Ok(vec![None; things.len()]);
        }
        let near = dilated(w, h, &rough.at(frame).raw, radius_px);
        let within = |outline: &Outline| {
            let mask = CompactMask::from_fn(w, h, |x, y| near[y * w + x] > 0 && outline.at(x, y));
            Outline::of(&mask)
                .filter(|left| left.area() as f64 >= LEAST_LEFT * outline.area() as f64)
        };
        Ok(shown.into_iter().map(|outline| within(outline?)).collect())
    };
    let mut cut: Vec<Vec<Option<Outline>>> = (0..frames)
        .into_par_iter()
        .map(of_frame)
        .collect::<Result<_, _>>()?;
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

/// The numbers of a frame: where things overlap, the smaller in this frame lies on top, of two of
/// the same area the lower number.
pub(super) fn painted_ids(
    things: &[(u16, &Outline)],
    (width, height): (usize, usize),
) -> Plane<u16> {
    let mut order: Vec<&(u16, &Outline)> = things.iter().collect();
    order.sort_by_key(|(id, outline)| std::cmp::Reverse((outline.area(), *id)));
    let mut out = Plane::filled(width, height, 0);
    for (id, outline) in order {
        for pixel in outline.pixels() {
            out[pixel] = *id;
        }
    }
    out
}

/// Gives holes of at most `most_px` pixels, which do not touch the border, the number that most of
/// their rim has.
pub(super) fn fill_holes(ids: &mut Plane<u16>, most_px: usize) {
    let (w, h) = ids.size();
    let empty: Vec<u8> = ids
        .data()
        .iter()
        .map(|&id| if id == 0 { 255 } else { 0 })
        .collect();
    for hole in Components::of(w, h, &empty).pixels {
        if hole.len() > most_px {
            continue;
        }
        let mut rim: BTreeMap<u16, usize> = BTreeMap::new();
        let mut open = false;
        for &p in &hole {
            let (x, y) = (p as usize % w, p as usize / w);
            open |= x == 0 || y == 0 || x + 1 == w || y + 1 == h;
            for (nx, ny) in [
                (x.wrapping_sub(1), y),
                (x + 1, y),
                (x, y.wrapping_sub(1)),
                (x, y + 1),
            ] {
                if nx < w && ny < h && ids[(nx, ny)] != 0 {
                    *rim.entry(ids[(nx, ny)]).or_default() += 1;
                }
            }
        }
        // Of equally many the lowest number.
        let most = rim
            .into_iter()
            .max_by_key(|&(id, count)| (count, std::cmp::Reverse(id)));
        if let (Some((id, _)), false) = (most, open) {
            for p in hole {
                ids.data_mut()[p as usize] = id;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{bounded, fill_holes, painted_ids};
    use crate::masks::coarse::{Coarse, CoarseMasks};
    use crate::masks::ledger::{Outline, TrackedObject};
    use crate::masks::{ObjectId, RefineSettings};
    use m4_core::{CompactMask, Silent};

    #[test]
    fn spreading_masks_are_cut_and_stray_ones_dropped() {
        let size = (64, 48);
        let block = |x0: usize, x1: usize| {
            CompactMask::from_fn(64, 48, move |x, y| {
                (x0..x1).contains(&x) && (10..30).contains(&y)
            })
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
        let masks = masks
            .iter()
            .map(Outline::of)
            .map(Option::unwrap)
            .enumerate()
            .collect();
        let thing = TrackedObject {
            object: ObjectId(7),
            prompted: 0,
            part_area: 200,
            part_centre_px: [15.0, 20.0],
            masks,
            lost: [false; 2],
        };
        let held = bounded(&rough, vec![thing], 12, 2.0 / 64.0, &Silent).unwrap();
        let held = &held[0].masks;
        assert_eq!(
            held.keys().copied().collect::<Vec<_>>(),
            [0, 1, 2, 3, 4, 5, 6, 7]
        );
        assert_eq!((held[&0].area(), held[&1].area()), (200, 200));
        let columns: Vec<usize> = held[&2].pixels().map(|(x, _)| x).collect();
        let right = columns.iter().copied().max().unwrap();
        assert!(
            (40..=42).contains(&right) && columns.iter().min() == Some(&30),
            "{right}"
        );
    }

    const SIZE: (usize, usize) = (30, 20);

    fn outline(f: impl Fn(usize, usize) -> bool) -> Outline {
        Outline::of(&CompactMask::from_fn(SIZE.0, SIZE.1, f)).unwrap()
    }

    #[test]
    fn the_smaller_lies_on_top_and_small_holes_close() {
        let large = outline(|x, y| {
            (2..22).contains(&x)
                && (2..18).contains(&y)
                && !((5..7).contains(&x) && y == 5)
                && x != 15
        });
        let small = outline(|x, y| (10..14).contains(&x) && (8..12).contains(&y));
        let mut ids = painted_ids(&[(3, &large), (7, &small)], SIZE);
        assert_eq!(
            (ids[(3, 3)], ids[(11, 9)], ids[(5, 5)], ids[(15, 9)]),
            (3, 7, 0, 0)
        );
        fill_holes(&mut ids, 4);
        assert_eq!((ids[(5, 5)], ids[(15, 9)], ids[(0, 0)]), (3, 0, 0));
        fill_holes(&mut ids, 10_000);
        // The gap at column 15 is open to what is outside.
        assert_eq!((ids[(15, 9)], ids[(0, 0)]), (0, 0));
    }
}
