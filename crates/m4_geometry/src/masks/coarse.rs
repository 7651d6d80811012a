//! Coarse dynamic masks, frame by frame, and their parts as prompts for a segmenter; masks made
//! larger and smaller by round elements, with exact distances.

use super::ledger::Outline;
use super::source::{ObjectId, ObjectPrompt};
use super::{InstanceError, RefineSettings};
use crate::classical::dense::{Components, belief, box_of, points_apart, to_outside};
use crate::resample::resize_bilinear;
use m4_core::{CompactMask, Plane};

/// Motion below which a pixel is surely static: there the places off a thing are taken from.
pub(super) const TAU_STILL: f32 = 0.3;
/// Radius of the opening of coarse masks, share of the longest side: 2 px of 480. Below 1 px there
/// is none.
const OPEN_SHARE: f32 = 2.0 / 480.0;
/// Least area of a coarse part, share of the image. Specification: 0.001 to 0.002.
const LEAST_AREA: f32 = 0.0015;

/// Coarse motion masks of a front end, one per frame, of any size with the aspect of the frames.
#[derive(Debug, Clone)]
pub enum Coarse<'a> {
    /// How likely each pixel is to move, 255 = certainly.
    Motion(Vec<&'a Plane<u8>>),
    /// Masks of dynamic pixels.
    Masks(Vec<&'a CompactMask>),
}

impl Coarse<'_> {
    /// Frames.
    #[must_use]
    pub fn frames(&self) -> usize {
        match self {
            Self::Motion(maps) => maps.len(),
            Self::Masks(masks) => masks.len(),
        }
    }

    /// `motion` or `masks`, for records.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Motion(_) => "motion",
            Self::Masks(_) => "masks",
        }
    }

    fn size(&self, frame: usize) -> (usize, usize) {
        match self {
            Self::Motion(maps) => maps[frame].size(),
            Self::Masks(masks) => masks[frame].size(),
        }
    }

    /// Refuses what cannot be worked with: another number of frames than the clip has, or a frame
    /// without pixels.
    pub(super) fn check(&self, frames: usize) -> Result<(), InstanceError> {
        let count = self.frames();
        let refused = |what: String| Err(InstanceError::Input(what));
        if count != frames {
            return refused(format!(
                "{count} coarse masks were given for {frames} frames; give one per frame"
            ));
        }
        match (0..frames).find(|&i| self.size(i).0 == 0 || self.size(i).1 == 0) {
            Some(frame) => refused(format!("the coarse mask of frame {frame} has no pixels")),
            None => Ok(()),
        }
    }
}

/// The coarse masks of a clip at the working size, made when they are asked for.
pub(super) struct CoarseMasks<'a> {
    pub coarse: &'a Coarse<'a>,
    pub size: (usize, usize),
    pub settings: &'a RefineSettings,
}

/// What is known of one frame.
pub(super) struct CoarseFrame {
    /// `[height][width]`, 255 where something moves: as given, without opening and without small
    /// parts left out.
    pub raw: Vec<u8>,
    /// The same opened, parts of less than the least area taken out.
    pub dynamic: Vec<u8>,
    /// `[height][width]`: where nothing moves for sure.
    pub still: Vec<bool>,
}

impl CoarseMasks<'_> {
    pub fn at(&self, frame: usize) -> CoarseFrame {
        let (w, h) = self.size;
        let (raw, still): (Vec<u8>, Vec<bool>) = match self.coarse {
            Coarse::Motion(maps) => {
                let share = maps[frame].map(|&m| f32::from(m) / 255.0);
                let share = resize_bilinear(&share, w, h);
                let of = |&p: &f32| (if p > self.settings.tau { 255 } else { 0 }, p < TAU_STILL);
                share.data().iter().map(of).unzip()
            }
            Coarse::Masks(masks) => {
                let share = masks[frame].to_mask().map(|&m| f32::from(m) / 255.0);
                let share = resize_bilinear(&share, w, h);
                share
                    .data()
                    .iter()
                    .map(|&p| (if p >= 0.5 { 255 } else { 0 }, p < 0.5))
                    .unzip()
            }
        };
        let radius_px = OPEN_SHARE * w.max(h) as f32;
        let mut dynamic = opened(w, h, &raw, radius_px);
        let least = self.least_px();
        for pixels in Components::of(w, h, &dynamic).pixels {
            if pixels.len() < least {
                for p in pixels {
                    dynamic[p as usize] = 0;
                }
            }
        }
        CoarseFrame {
            raw,
            dynamic,
            still,
        }
    }

    /// The least area of a part, pixels.
    pub fn least_px(&self) -> usize {
        let (w, h) = self.size;
        ((LEAST_AREA * (w * h) as f32).ceil() as usize).max(1)
    }
}

/// Pixels of a mask (above 0) deeper than `radius_px`. The border of the image is no edge.
pub(super) fn eroded(width: usize, height: usize, mask: &[u8], radius_px: f32) -> Vec<u8> {
    let depth = to_outside(width, height, |p| mask[p] > 0);
    depth
        .iter()
        .map(|&d| if d > radius_px { 255 } else { 0 })
        .collect()
}

/// Pixels no farther than `radius_px` from one of a mask (above 0).
pub(super) fn dilated(width: usize, height: usize, mask: &[u8], radius_px: f32) -> Vec<u8> {
    let away = to_outside(width, height, |p| mask[p] == 0);
    away.iter()
        .map(|&d| if d <= radius_px { 255 } else { 0 })
        .collect()
}

/// What of a mask a disc of `radius_px` inside of it can reach: without specks and threads.
pub(super) fn opened(width: usize, height: usize, mask: &[u8], radius_px: f32) -> Vec<u8> {
    if radius_px < 1.0 {
        return mask.to_vec();
    }
    // A disc around the middle of a pixel reaches its neighbours at a distance of 1 and not their
    // edges.
    let core = eroded(width, height, mask, radius_px);
    dilated(width, height, &core, radius_px)
}

/// Places on a thing. Specification: 3 to 5.
const POINTS_ON: usize = 4;
/// Places off a thing. Specification: 1 to 2.
const POINTS_OFF: usize = 2;
/// By how much the masks of things are grown before the coarse pixels outside of them are searched,
/// share of the longest side: 10 px of 480, since maps of an eighth of the size are off by as much.
/// What is left is opened by half of it, so that rims are no things.
const COVER_SHARE: f32 = 10.0 / 480.0;
/// In how many of three frames around it a part must be seen. Specification: 2. It holds for the
/// first frame, too, where the paper does not ask for it.
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
        Self {
            here: rough.at(frame),
            others: others.map(|i| rough.at(i)).collect(),
        }
    }
}

/// The parts that things, whose pixels in this frame are `covered`, leave, the largest first. A
/// clip of fewer frames than three counts each as seen where there is none.
pub(super) fn proposals(rough: &CoarseMasks<'_>, around: &Around, covered: &[u8]) -> Vec<Proposal> {
    let (w, h) = rough.size;
    let reach_px = COVER_SHARE * w.max(h) as f32;
    let covered = dilated(w, h, covered, reach_px);
    let mut left = around.here.dynamic.clone();
    for (m, c) in left.iter_mut().zip(&covered) {
        if *c > 0 {
            *m = 0;
        }
    }
    let left = if covered.contains(&255) {
        opened(w, h, &left, 0.5 * reach_px)
    } else {
        left
    };
    let others: Vec<Vec<u8>> = around
        .others
        .iter()
        .map(|o| dilated(w, h, &o.dynamic, reach_px))
        .collect();
    let least = rough.least_px();
    let mut out: Vec<Proposal> = Vec::new();
    for pixels in Components::of(w, h, &left).pixels {
        if pixels.len() < least {
            continue;
        }
        let is_present = |other: &&Vec<u8>| {
            let overlap = pixels.iter().filter(|&&p| other[p as usize] > 0).count();
            overlap as f32 >= PERSISTENT_OVERLAP * pixels.len() as f32
        };
        let seen_in = 1 + others.iter().filter(is_present).count() + (2 - others.len().min(2));
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
pub(super) fn prompt(
    object: ObjectId,
    part: &Outline,
    here: &CoarseFrame,
    (w, h): (usize, usize),
) -> ObjectPrompt {
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
        box_px: box_of(part.pixels()),
        belief: belief(&inner, &outer),
    }
}

/// Points near the part that are surely static: deep in static regions, then the farthest from
/// those before. `outer` is the distance to the part.
fn points_off(
    part: &Outline,
    here: &CoarseFrame,
    outer: &[f32],
    (w, h): (usize, usize),
) -> Vec<[f32; 2]> {
    let gap_px = (0.15 * (part.area() as f32).sqrt()).max(4.0);
    let clear = to_outside(w, h, |p| here.still[p] && here.raw[p] == 0);
    let good: Vec<usize> = (0..w * h)
        .filter(|&p| clear[p] >= 0.5 * gap_px && outer[p] >= gap_px && outer[p] <= 4.0 * gap_px)
        .collect();
    let mut out: Vec<[f32; 2]> = Vec::new();
    for _ in 0..POINTS_OFF {
        let score = |p: usize| {
            let (x, y) = ((p % w) as f32 + 0.5, (p / w) as f32 + 0.5);
            let nearest = out
                .iter()
                .map(|o| (o[0] - x).hypot(o[1] - y))
                .fold(f32::INFINITY, f32::min);
            let depth = clear[p].min(gap_px) / gap_px;
            // Before there is any, near is good; afterwards, far from those that are there.
            let place = if out.is_empty() {
                -0.1 * outer[p] / gap_px
            } else {
                0.5 * nearest / gap_px
            };
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

#[cfg(test)]
mod tests {
    use super::{dilated, eroded, opened};

    const W: usize = 40;
    const H: usize = 30;

    fn count(mask: &[u8]) -> usize {
        mask.iter().filter(|&&m| m > 0).count()
    }

    #[test]
    fn opening_removes_thin_parts_only() {
        let square = |x: usize, y: usize| (5..25).contains(&x) && (5..20).contains(&y);
        let thread = |x: usize, y: usize| y == 25 && x > 3 || x == 30;
        let mask: Vec<u8> = (0..W * H)
            .map(|p| u8::from(square(p % W, p / W) || thread(p % W, p / W)))
            .collect();
        let actual = opened(W, H, &mask, 2.0);
        for p in 0..W * H {
            let (x, y) = (p % W, p / W);
            assert!(actual[p] == 0 || square(x, y), "column {x}, row {y}");
            assert!(
                actual[p] > 0 || !square(x, y) || on_corner(x, y),
                "column {x}, row {y}"
            );
        }
        assert!(count(&actual) > 20 * 15 - 16);
        assert_eq!(count(&opened(W, H, &vec![0; W * H], 2.0)), 0);
        assert_eq!(count(&opened(W, H, &vec![9; W * H], 2.0)), W * H);
    }

    fn on_corner(x: usize, y: usize) -> bool {
        !(7..=22).contains(&x) && !(7..=17).contains(&y)
    }

    #[test]
    fn larger_and_smaller_by_the_radius() {
        let mask: Vec<u8> = (0..W * H).map(|p| u8::from(p % W >= 10)).collect();
        assert_eq!(count(&dilated(W, H, &mask, 3.0)), (W - 7) * H);
        assert_eq!(count(&eroded(W, H, &mask, 3.0)), (W - 13) * H);
    }
}
