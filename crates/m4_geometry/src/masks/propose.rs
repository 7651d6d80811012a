//! Proposes coarse parts as objects, and the prompts for a segmenter.

use super::coarse::{CoarseFrame, CoarseMasks, dilated, opened};
use super::ledger::Outline;
use super::source::{ObjectId, ObjectPrompt};
use crate::classical::dense::{Components, belief, box_of, points_apart, to_outside};
use m4_core::CompactMask;

/// Places on a thing. Specification: 3 to 5.
const POINTS_ON: usize = 4;
/// Places off a thing. Specification: 1 to 2.
const POINTS_OFF: usize = 2;
/// By how much the masks of things are grown before the coarse pixels outside of them are searched, share of the longest side: 10 px of
/// 480, since maps of an eighth of the size are off by as much. What is left is opened by half of it, so that rims are no things.
const COVER_SHARE: f32 = 10.0 / 480.0;
/// In how many of three frames around it a part must be seen. Specification: 2. It holds for the first frame, too, where the paper does
/// not ask for it.
pub(super) const PERSISTENT_IN: usize = 2;
/// Share of a part's pixels that must be coarse in another frame for it to be seen there.
const PERSISTENT_OVERLAP: f32 = 0.5;

/// A part of the coarse mask that no thing covers.
pub(super) struct Proposal {
    pub outline: Outline,
    /// In how many of three frames around it it is seen.
    pub seen_in: usize,
}

/// Coarse masks of the frames around one.
pub(super) struct Around {
    /// The frame itself.
    pub here: CoarseFrame,
    /// Its neighbours', as far as the clip goes; the frame itself is not among them.
    pub others: Vec<CoarseFrame>,
}

impl Around {
    /// Three frames: the one before and the one after, or at an end of the clip the next two.
    pub fn of(rough: &CoarseMasks<'_>, frame: usize, frames: usize) -> Self {
        let first = frame.saturating_sub(1).min(frames.saturating_sub(3));
        let others = (first..(first + 3).min(frames)).filter(|&i| i != frame);
        Self { here: rough.at(frame), others: others.map(|i| rough.at(i)).collect() }
    }
}

/// The parts that things, whose pixels in this frame are `covered`, leave, the largest first. A clip of fewer frames than three
/// counts each as seen where there is none.
pub(super) fn proposals(rough: &CoarseMasks<'_>, around: &Around, covered: &[u8]) -> Vec<Proposal> {
    let (w, h) = rough.size;
    let reach_px = COVER_SHARE * w.max(h) as f32;
    let covered = dilated(w, h, covered, reach_px);
    let mut left = around.here.moving.clone();
    for (m, c) in left.iter_mut().zip(&covered) {
        if *c > 0 {
            *m = 0;
        }
    }
    let left = if covered.contains(&255) { opened(w, h, &left, 0.5 * reach_px) } else { left };
    let others: Vec<Vec<u8>> = around.others.iter().map(|o| dilated(w, h, &o.moving, reach_px)).collect();
    let least = rough.least_px();
    let mut out: Vec<Proposal> = Vec::new();
    for pixels in Components::of(w, h, &left).pixels {
        if pixels.len() < least {
            continue;
        }
        let seen = |other: &&Vec<u8>| {
            let there = pixels.iter().filter(|&&p| other[p as usize] > 0).count();
            there as f32 >= PERSISTENT_OVERLAP * pixels.len() as f32
        };
        let seen_in = 1 + others.iter().filter(seen).count() + (2 - others.len().min(2));
        let mut inside = vec![false; w * h];
        for &p in &pixels {
            inside[p as usize] = true;
        }
        let mask = CompactMask::from_fn(w, h, |x, y| inside[y * w + x]);
        if let Some(outline) = Outline::of(&mask) {
            out.push(Proposal { outline, seen_in });
        }
    }
    out.sort_by_key(|p| std::cmp::Reverse(p.outline.area()));
    out
}

/// The prompt of a part for a segmenter.
pub(super) fn prompt(object: ObjectId, part: &Outline, here: &CoarseFrame, (w, h): (usize, usize)) -> ObjectPrompt {
    let mut inside = vec![false; w * h];
    for (x, y) in part.pixels() {
        inside[y * w + x] = true;
    }
    let inner = to_outside(w, h, |p| inside[p]);
    let outer = to_outside(w, h, |p| !inside[p]);
    ObjectPrompt {
        object,
        on_px: points_apart(w, h, &inner, POINTS_ON),
        off_px: points_off(part, here, &outer, (w, h)),
        box_px: Some(box_of(part.pixels())),
        belief: Some(belief(&inner, &outer)),
    }
}

/// Points near the part that are surely static: deep in static regions, then the farthest from those before. `outer` is the distance to the part.
fn points_off(part: &Outline, here: &CoarseFrame, outer: &[f32], (w, h): (usize, usize)) -> Vec<[f32; 2]> {
    let gap_px = (0.15 * (part.area() as f32).sqrt()).max(4.0);
    let clear = to_outside(w, h, |p| here.still[p] && here.raw[p] == 0);
    let good: Vec<usize> =
        (0..w * h).filter(|&p| clear[p] >= 0.5 * gap_px && outer[p] >= gap_px && outer[p] <= 4.0 * gap_px).collect();
    let mut out: Vec<[f32; 2]> = Vec::new();
    for _ in 0..POINTS_OFF {
        let score = |p: usize| {
            let (x, y) = ((p % w) as f32 + 0.5, (p / w) as f32 + 0.5);
            let nearest = out.iter().map(|o| (o[0] - x).hypot(o[1] - y)).fold(f32::INFINITY, f32::min);
            let depth = clear[p].min(gap_px) / gap_px;
            // Before there is any, near is good; afterwards, far from those that are there.
            let place = if out.is_empty() { -0.1 * outer[p] / gap_px } else { 0.5 * nearest / gap_px };
            (nearest >= gap_px).then_some(depth + place)
        };
        let best = good.iter().filter_map(|&p| Some((p, score(p)?)));
        let best = best.fold(None, |best: Option<(usize, f32)>, (p, s)| match best {
            Some((_, most)) if most >= s => best,
            _ => Some((p, s)),
        });
        let Some((p, _)) = best else { break };
        out.push([(p % w) as f32 + 0.5, (p / w) as f32 + 0.5]);
    }
    out
}
