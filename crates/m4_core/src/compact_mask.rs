//! Masks as a capture holds them.

use crate::{Mask, Plane};

/// A mask of one bit per pixel.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct CompactMask {
    width: usize,
    height: usize,
    /// Pixel `i`, row by row, is bit `i % 64` of word `i / 64`; bits after the last are 0.
    words: Vec<u64>,
}

impl CompactMask {
    /// A mask whose value at column `x` of row `y` is `f(x, y)`.
    pub fn from_fn(width: usize, height: usize, mut f: impl FnMut(usize, usize) -> bool) -> Self {
        let n = width * height;
        let word = |k: usize| {
            let pixels = 64 * k..n.min(64 * k + 64);
            pixels.fold(0u64, |word, i| word | u64::from(f(i % width, i / width)) << (i % 64))
        };
        Self { width, height, words: (0..n.div_ceil(64)).map(word).collect() }
    }

    /// `(width, height)`.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// The value at column `x` of row `y`, both inside of the mask.
    #[must_use]
    pub fn at(&self, x: usize, y: usize) -> bool {
        let i = y * self.width + x;
        self.words[i / 64] >> (i % 64) & 1 == 1
    }

    /// Number of pixels that are set.
    #[must_use]
    pub fn count(&self) -> usize {
        self.words.iter().map(|w| w.count_ones() as usize).sum()
    }

    /// Column and row of every pixel that is set, row by row.
    pub fn set_pixels(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let width = self.width;
        self.words.iter().enumerate().flat_map(move |(k, &word)| {
            // each step takes the lowest bit away
            let rest = std::iter::successors(Some(word), |w| Some(w & w.wrapping_sub(1)));
            rest.take_while(|w| *w != 0).map(move |w| {
                let i = 64 * k + w.trailing_zeros() as usize;
                (i % width, i / width)
            })
        })
    }

    /// The mask as bytes, 255 where it is set.
    #[must_use]
    pub fn to_mask(&self) -> Mask {
        Plane::from_fn(self.width, self.height, |x, y| if self.at(x, y) { 255 } else { 0 })
    }

    /// Size in memory, bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of_val(self.words.as_slice())
    }
}

impl From<&Mask> for CompactMask {
    /// Set where the byte is at least 128.
    fn from(mask: &Mask) -> Self {
        Self::from_fn(mask.width(), mask.height(), |x, y| mask[(x, y)] >= 128)
    }
}

impl From<Mask> for CompactMask {
    /// Set where the byte is at least 128.
    fn from(mask: Mask) -> Self {
        Self::from(&mask)
    }
}

#[cfg(test)]
mod tests {
    use super::CompactMask;
    use crate::{Mask, Plane};

    #[test]
    fn masks_of_every_size_round_trip() {
        for (w, h) in [(0, 0), (0, 3), (1, 1), (63, 1), (64, 1), (13, 5), (16, 8), (129, 2)] {
            let mask: Mask = Plane::from_fn(w, h, |x, y| if (x * x + 3 * y) % 5 < 2 { 255 } else { 0 });
            let held = CompactMask::from(&mask);
            assert_eq!((held.size(), held.to_mask()), ((w, h), mask.clone()));
            let set = mask.data().iter().filter(|&&m| m != 0).count();
            assert_eq!((held.count(), held.bytes()), (set, (w * h).div_ceil(64) * 8));
            let one_by_one = (0..w * h).map(|i| (i % w, i / w)).filter(|&(x, y)| held.at(x, y));
            assert!(held.set_pixels().eq(one_by_one), "{w} x {h}");
        }
    }

    #[test]
    fn half_bright_is_set() {
        let held = CompactMask::from(Plane::from_vec(4, 1, vec![0, 127, 128, 255]).unwrap());
        assert_eq!([0, 1, 2, 3].map(|x| held.at(x, 0)), [false, false, true, true]);
        assert_eq!(held, CompactMask::from_fn(4, 1, |x, _| x >= 2));
        assert_ne!(held, CompactMask::from_fn(2, 2, |_, y| y == 1), "sizes count");
    }
}
