//! Masks, depth maps and instance maps as a capture stores them: small in memory, bit for bit the
//! same.

use crate::{DepthMap, Mask, Plane, covering};

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
            pixels.fold(0u64, |word, i| {
                word | u64::from(f(i % width, i / width)) << (i % 64)
            })
        };
        Self {
            width,
            height,
            words: (0..n.div_ceil(64)).map(word).collect(),
        }
    }

    /// `(width, height)`.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// The value at column `x` of row `y`, both inside of the mask.
    pub fn at(&self, x: usize, y: usize) -> bool {
        let i = y * self.width + x;
        self.words[i / 64] >> (i % 64) & 1 == 1
    }

    /// Whether it is set where it covers the centre of pixel `p` of an image of size `from`.
    pub fn covers(&self, p: (usize, usize), from: (usize, usize)) -> bool {
        let (x, y) = covering(p, from, self.size());
        self.at(x, y)
    }

    /// Number of pixels that are set.
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
    pub fn to_mask(&self) -> Mask {
        Plane::from_fn(
            self.width,
            self.height,
            |x, y| if self.at(x, y) { 255 } else { 0 },
        )
    }

    /// Size in memory, bytes.
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

/// A depth map that takes as little memory as where it came from: two bytes per pixel for one of
/// 16-bit steps, four for floats. Both come back bit by bit.
#[derive(Debug, Clone)]
pub struct CompactDepth(Values);

#[derive(Debug, Clone)]
enum Values {
    Floats(DepthMap),
    Steps { steps: Plane<u16>, unit: f64 },
}

impl CompactDepth {
    /// A map whose depth is `steps` times `unit`, scene units per step; 0 steps = depth unknown.
    pub fn from_steps(steps: Plane<u16>, unit: f64) -> Self {
        Self(Values::Steps { steps, unit })
    }

    /// `(width, height)`.
    pub fn size(&self) -> (usize, usize) {
        match &self.0 {
            Values::Floats(map) => map.size(),
            Values::Steps { steps, .. } => steps.size(),
        }
    }

    /// z-depth at column `x` of row `y`.
    pub fn at(&self, x: usize, y: usize) -> f32 {
        match &self.0 {
            Values::Floats(map) => map[(x, y)],
            Values::Steps { steps, unit } => depth(steps[(x, y)], *unit),
        }
    }

    /// The depth where it covers the centre of pixel `p` of an image of size `from`.
    pub fn covering(&self, p: (usize, usize), from: (usize, usize)) -> f32 {
        let (x, y) = covering(p, from, self.size());
        self.at(x, y)
    }

    /// z-depth of every `stride`-th pixel (at least 1), row by row from the first.
    pub fn every(&self, stride: usize) -> impl Iterator<Item = f32> + '_ {
        let (floats, steps): (&[f32], (&[u16], f64)) = match &self.0 {
            Values::Floats(map) => (map.data(), (&[], 1.0)),
            Values::Steps { steps, unit } => (&[], (steps.data(), *unit)),
        };
        let (steps, unit) = steps;
        let decoded = steps.iter().step_by(stride).map(move |&v| depth(v, unit));
        floats.iter().step_by(stride).copied().chain(decoded)
    }

    /// The map as floats, four bytes per pixel.
    pub fn to_map(&self) -> DepthMap {
        match &self.0 {
            Values::Floats(map) => map.clone(),
            Values::Steps { steps, unit } => steps.map(|&v| depth(v, *unit)),
        }
    }

    /// Size in memory, bytes.
    pub fn bytes(&self) -> usize {
        match &self.0 {
            Values::Floats(map) => size_of_val(map.data()),
            Values::Steps { steps, .. } => size_of_val(steps.data()),
        }
    }
}

impl From<DepthMap> for CompactDepth {
    fn from(map: DepthMap) -> Self {
        Self(Values::Floats(map))
    }
}

impl PartialEq for CompactDepth {
    /// By size and depth, however they are held; depth that is not a number is equal to nothing.
    fn eq(&self, other: &Self) -> bool {
        self.size() == other.size() && self.every(1).eq(other.every(1))
    }
}

fn depth(steps: u16, unit: f64) -> f32 {
    (f64::from(steps) * unit) as f32
}

/// A number per pixel, 0 for nothing in particular, held as runs of equal numbers.
///
/// Things are large and smooth: a map takes some hundred bytes a thing where it would take two a
/// pixel.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct CompactIds {
    width: usize,
    height: usize,
    /// The first pixel of a run, row by row, and its number; a run ends where the next begins.
    runs: Vec<(u32, u16)>,
}

impl CompactIds {
    /// The number at column `x` of row `y`, both inside of the map.
    pub fn at(&self, x: usize, y: usize) -> u16 {
        let pixel = (y * self.width + x) as u32;
        let after = self.runs.partition_point(|&(first, _)| first <= pixel);
        after.checked_sub(1).map_or(0, |run| self.runs[run].1)
    }

    /// `(width, height)`.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// The largest number.
    pub fn largest(&self) -> u16 {
        self.runs.iter().map(|&(_, id)| id).max().unwrap_or(0)
    }

    /// The map with every number written out.
    pub fn to_plane(&self) -> Plane<u16> {
        let mut out = Plane::filled(self.width, self.height, 0);
        for (k, &(first, id)) in self.runs.iter().enumerate() {
            let end = self
                .runs
                .get(k + 1)
                .map_or(self.width * self.height, |next| next.0 as usize);
            out.data_mut()[first as usize..end].fill(id);
        }
        out
    }

    /// Where something is.
    pub fn to_mask(&self) -> CompactMask {
        let plane = self.to_plane();
        CompactMask::from_fn(self.width, self.height, |x, y| plane[(x, y)] != 0)
    }

    /// Size in memory, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.runs.as_slice())
    }
}

impl From<&Plane<u16>> for CompactIds {
    fn from(ids: &Plane<u16>) -> Self {
        let mut runs: Vec<(u32, u16)> = Vec::new();
        for (pixel, &id) in ids.data().iter().enumerate() {
            if runs.last().is_none_or(|&(_, last)| last != id) {
                runs.push((pixel as u32, id));
            }
        }
        Self {
            width: ids.width(),
            height: ids.height(),
            runs,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{CompactDepth, CompactIds, CompactMask};
    use crate::{DepthMap, Mask, Plane};

    #[test]
    fn masks_of_every_size_round_trip() {
        for (w, h) in [
            (0, 0),
            (0, 3),
            (1, 1),
            (63, 1),
            (64, 1),
            (13, 5),
            (16, 8),
            (129, 2),
        ] {
            let mask: Mask =
                Plane::from_fn(w, h, |x, y| if (x * x + 3 * y) % 5 < 2 { 255 } else { 0 });
            let held = CompactMask::from(&mask);
            assert_eq!((held.size(), held.to_mask()), ((w, h), mask.clone()));
            let set = mask.data().iter().filter(|&&m| m != 0).count();
            assert_eq!(
                (held.count(), held.bytes()),
                (set, (w * h).div_ceil(64) * 8)
            );
            let one_by_one = (0..w * h)
                .map(|i| (i % w, i / w))
                .filter(|&(x, y)| held.at(x, y));
            assert!(held.set_pixels().eq(one_by_one), "{w} x {h}");
        }
    }

    #[test]
    fn half_bright_is_set() {
        let held = CompactMask::from(Plane::from_vec(4, 1, vec![0, 127, 128, 255]).unwrap());
        assert_eq!(
            [0, 1, 2, 3].map(|x| held.at(x, 0)),
            [false, false, true, true]
        );
        assert_eq!(held, CompactMask::from_fn(4, 1, |x, _| x >= 2));
        assert_ne!(
            held,
            CompactMask::from_fn(2, 2, |_, y| y == 1),
            "sizes count"
        );
    }

    const UNIT: f64 = 0.001_234_567;

    fn both() -> (CompactDepth, CompactDepth) {
        let steps = Plane::from_fn(7, 5, |x, y| (x * 9001 + y * 301) as u16);
        let floats: DepthMap = steps.map(|&v| (f64::from(v) * UNIT) as f32);
        (CompactDepth::from_steps(steps, UNIT), floats.into())
    }

    #[test]
    fn steps_and_floats_are_the_same_bits_and_half_the_bytes() {
        let (steps, floats) = both();
        assert_eq!(steps, floats);
        assert_eq!(steps.to_map(), floats.to_map());
        assert_eq!((steps.bytes(), floats.bytes()), (70, 140));
        let map = floats.to_map();
        for held in [&steps, &floats] {
            assert_eq!(held.size(), (7, 5));
            assert_eq!(held.at(0, 0), 0.0, "unknown stays unknown");
            for y in 0..5 {
                assert!((0..7).all(|x| held.at(x, y) == map[(x, y)]));
            }
            let thirds: Vec<f32> = held.every(3).collect();
            assert_eq!(
                thirds,
                map.data().iter().step_by(3).copied().collect::<Vec<_>>()
            );
        }
    }

    #[test]
    fn unquantisable_depth_is_stored_as_floats() {
        let map = Plane::from_vec(2, 1, vec![f32::NAN, -1.5e-20]).unwrap();
        let held = CompactDepth::from(map);
        assert!(held.at(0, 0).is_nan() && held.to_map()[(1, 0)] == -1.5e-20);
        assert_ne!(held, held.clone(), "not a number is equal to nothing");
        let (steps, _) = both();
        let other = CompactDepth::from_steps(Plane::filled(5, 7, 0), UNIT);
        assert_ne!(steps, other, "sizes count");
        assert_eq!(
            CompactDepth::from_steps(Plane::filled(0, 0, 0), UNIT)
                .every(1)
                .count(),
            0
        );
    }

    #[test]
    fn id_maps_round_trip() {
        for (w, h) in [(0, 0), (0, 3), (1, 1), (7, 1), (13, 5), (64, 9)] {
            let ids = Plane::from_fn(w, h, |x, y| {
                if (x / 3 + y) % 4 < 2 {
                    0
                } else {
                    (300 * (x / 3)) as u16
                }
            });
            let held = CompactIds::from(&ids);
            assert_eq!((held.size(), held.to_plane()), ((w, h), ids.clone()));
            assert!(
                (0..w * h).all(|i| held.at(i % w, i / w) == ids[(i % w, i / w)]),
                "{w} x {h}"
            );
            assert_eq!(
                held.largest(),
                ids.data().iter().copied().max().unwrap_or(0)
            );
            assert_eq!(
                held.to_mask().count(),
                ids.data().iter().filter(|&&id| id != 0).count()
            );
        }
    }

    #[test]
    fn large_objects_take_few_bytes() {
        let held = CompactIds::from(&Plane::from_fn(480, 360, |x, y| {
            u16::from((100..200).contains(&x) && (50..150).contains(&y))
        }));
        assert_eq!((held.bytes(), held.largest()), (201 * 8, 1));
    }
}
