//! A mask that takes the room of its box.

use m4_core::CompactMask;

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
        let bits = CompactMask::from_fn(right + 1 - left, bottom + 1 - top, |x, y| mask.at(left + x, top + y));
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
        self.bits.set_pixels().map(|(x, y)| (self.left + x, self.top + y))
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
