//! Objects, where they were seen, and masks that take the room of their box.

use super::source::{ObjectId, ObjectMask};
use super::{Ending, InstanceRecord};
use m4_core::CompactMask;
use std::collections::BTreeMap;

/// A mask that grows by more than this from one frame to the next and covers too much has become
/// background.
const LEAP: usize = 2;

/// One object.
pub(super) struct TrackedObject {
    pub object: ObjectId,
    pub prompted: usize,
    /// The coarse part that it was asked for.
    pub part_area: usize,
    pub part_centre_px: [f32; 2],
    /// By frame.
    pub masks: BTreeMap<usize, Outline>,
    /// Whether it is lost for good towards the end, towards the beginning.
    pub lost: [bool; 2],
}

impl TrackedObject {
    /// Notes how it is seen in a frame, going on in a direction; `most_px` is the area beyond which
    /// a sudden growth is background.
    pub fn note(&mut self, frame: usize, answer: &ObjectMask, later: bool, most_px: usize) {
        self.lost[usize::from(!later)] |= answer.lost;
        let Some(outline) = Outline::of(&answer.mask) else {
            return;
        };
        let near = if later {
            self.masks.range(..frame).next_back()
        } else {
            self.masks.range(frame + 1..).next()
        };
        let before = near.map_or(usize::MAX, |(_, mask)| mask.area());
        if outline.area() <= most_px || outline.area() / LEAP <= before {
            self.masks.insert(frame, outline);
        }
    }

    /// Half of the frames that both are seen in, they overlap by more than `least`.
    pub fn is_also(&self, other: &Self, least: f32) -> bool {
        let common = self
            .masks
            .iter()
            .filter_map(|(frame, a)| Some((a, other.masks.get(frame)?)));
        let (mut same, mut all) = (0usize, 0usize);
        for (a, b) in common {
            all += 1;
            same += usize::from(a.overlap(b) > least);
        }
        all > 0 && 2 * same > all
    }

    /// Takes over what another is, which turned out to be the same.
    pub fn absorb(&mut self, other: Self, size: (usize, usize)) {
        let last = |masks: &BTreeMap<usize, Outline>| masks.keys().next_back().copied();
        if last(&other.masks) > last(&self.masks) {
            self.lost[0] = other.lost[0];
        }
        for (frame, mask) in other.masks {
            let mask = match self.masks.get(&frame) {
                Some(own) => own.with(&mask, size),
                None => mask,
            };
            self.masks.insert(frame, mask);
        }
    }

    /// What the report says of it; `None` if no frame shows it.
    pub fn record(
        &self,
        id: u16,
        supported_share: f64,
        pixels: usize,
        frames: usize,
    ) -> Option<InstanceRecord> {
        let (&first_frame, _) = self.masks.first_key_value()?;
        let (&last_frame, _) = self.masks.last_key_value()?;
        let area: usize = self.masks.values().map(Outline::area).sum();
        let ending = match (last_frame + 1 == frames, self.lost[0]) {
            (true, _) => Ending::ClipEnd,
            (false, true) => Ending::Lost {
                frame: last_frame + 1,
            },
            (false, false) => Ending::Unseen {
                frame: last_frame + 1,
            },
        };
        Some(InstanceRecord {
            id,
            first_frame,
            last_frame,
            frames: self.masks.len(),
            mean_area_share: area as f64 / pixels.max(1) as f64 / self.masks.len() as f64,
            prompted_frame: self.prompted,
            supported_share,
            ending,
        })
    }
}

/// The pixels of a thing, held from the first to the last column and row that it touches.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Outline {
    left: usize,
    top: usize,
    bits: CompactMask,
    area: usize,
}

impl Outline {
    /// `None` for a mask without pixels.
    pub fn of(mask: &CompactMask) -> Option<Self> {
        let mut ends: Option<[usize; 4]> = None;
        for (x, y) in mask.set_pixels() {
            let [x0, y0, x1, y1] = ends.unwrap_or([x, y, x, y]);
            ends = Some([x0.min(x), y0.min(y), x1.max(x), y1.max(y)]);
        }
        let [left, top, right, bottom] = ends?;
        let bits = CompactMask::from_fn(right + 1 - left, bottom + 1 - top, |x, y| {
            mask.at(left + x, top + y)
        });
        Some(Self {
            left,
            top,
            area: bits.count(),
            bits,
        })
    }

    /// Pixels.
    pub fn area(&self) -> usize {
        self.area
    }

    /// Column and row of its middle.
    pub fn centre_px(&self) -> [f32; 2] {
        let (mut sx, mut sy) = (0.0f64, 0.0f64);
        for (x, y) in self.pixels() {
            (sx, sy) = (sx + x as f64 + 0.5, sy + y as f64 + 0.5);
        }
        [sx, sy].map(|s| (s / self.area as f64) as f32)
    }

    /// Whether the pixel belongs to the thing; outside of its box none does.
    pub fn at(&self, x: usize, y: usize) -> bool {
        let (w, h) = self.bits.size();
        x >= self.left
            && y >= self.top
            && x - self.left < w
            && y - self.top < h
            && self.bits.at(x - self.left, y - self.top)
    }

    /// Column and row of every pixel, row by row.
    pub fn pixels(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.bits
            .set_pixels()
            .map(|(x, y)| (self.left + x, self.top + y))
    }

    /// Pixels that both have.
    pub fn common(&self, other: &Self) -> usize {
        let (small, large) = if self.area <= other.area {
            (self, other)
        } else {
            (other, self)
        };
        small.pixels().filter(|&(x, y)| large.at(x, y)).count()
    }

    /// Intersection over union.
    pub fn overlap(&self, other: &Self) -> f32 {
        let common = self.common(other);
        common as f32 / (self.area + other.area - common) as f32
    }

    /// Both.
    pub fn with(&self, other: &Self, (width, height): (usize, usize)) -> Self {
        let both = CompactMask::from_fn(width, height, |x, y| self.at(x, y) || other.at(x, y));
        Self::of(&both).unwrap_or_else(|| self.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::Outline;
    use m4_core::CompactMask;

    #[test]
    fn an_outline_is_its_mask() {
        let (w, h) = (40, 30);
        let one = CompactMask::from_fn(w, h, |x, y| {
            (10..20).contains(&x) && (5..15).contains(&y) && (x + y) % 7 > 0
        });
        let two = CompactMask::from_fn(w, h, |x, y| (15..30).contains(&x) && (0..12).contains(&y));
        let (a, b) = (Outline::of(&one).unwrap(), Outline::of(&two).unwrap());
        assert_eq!((a.area(), b.area()), (one.count(), 180));
        assert!((0..w * h).all(|i| a.at(i % w, i / w) == one.at(i % w, i / w)));
        let both = (0..w * h)
            .filter(|i| one.at(i % w, i / w) && two.at(i % w, i / w))
            .count();
        assert_eq!((a.common(&b), b.common(&a)), (both, both));
        assert_eq!(a.overlap(&b), both as f32 / (a.area() + 180 - both) as f32);
        assert_eq!(a.with(&b, (w, h)).area(), a.area() + 180 - both);
        assert_eq!(a.with(&a, (w, h)), a);
        assert!(Outline::of(&CompactMask::from_fn(w, h, |_, _| false)).is_none());
    }
}
