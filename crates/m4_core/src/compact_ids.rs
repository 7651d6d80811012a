//! Maps of which thing each pixel shows, as a capture holds them.

use crate::{CompactMask, Plane};

/// A number per pixel, 0 for nothing in particular, held as runs of equal numbers.
///
/// Things are large and smooth: a map takes some hundred bytes a thing where it would take two a pixel.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct CompactIds {
    width: usize,
    height: usize,
    /// The first pixel of a run, row by row, and its number; a run ends where the next begins.
    runs: Vec<(u32, u16)>,
}

impl CompactIds {
    /// The number at column `x` of row `y`, both inside of the map.
    #[must_use]
    pub fn at(&self, x: usize, y: usize) -> u16 {
        let pixel = (y * self.width + x) as u32;
        let after = self.runs.partition_point(|&(first, _)| first <= pixel);
        after.checked_sub(1).map_or(0, |run| self.runs[run].1)
    }

    /// `(width, height)`.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// The largest number.
    #[must_use]
    pub fn largest(&self) -> u16 {
        self.runs.iter().map(|&(_, id)| id).max().unwrap_or(0)
    }

    /// The map with every number written out.
    #[must_use]
    pub fn to_plane(&self) -> Plane<u16> {
        let mut out = Plane::filled(self.width, self.height, 0);
        for (k, &(first, id)) in self.runs.iter().enumerate() {
            let end = self.runs.get(k + 1).map_or(self.width * self.height, |next| next.0 as usize);
            out.data_mut()[first as usize..end].fill(id);
        }
        out
    }

    /// Where something is.
    #[must_use]
    pub fn to_mask(&self) -> CompactMask {
        let plane = self.to_plane();
        CompactMask::from_fn(self.width, self.height, |x, y| plane[(x, y)] != 0)
    }

    /// Size in memory, bytes.
    #[must_use]
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
        Self { width: ids.width(), height: ids.height(), runs }
    }
}

#[cfg(test)]
mod tests {
    use super::CompactIds;
    use crate::Plane;

    #[test]
    fn id_maps_round_trip() {
        for (w, h) in [(0, 0), (0, 3), (1, 1), (7, 1), (13, 5), (64, 9)] {
            let ids = Plane::from_fn(w, h, |x, y| if (x / 3 + y) % 4 < 2 { 0 } else { (300 * (x / 3)) as u16 });
            let held = CompactIds::from(&ids);
            assert_eq!((held.size(), held.to_plane()), ((w, h), ids.clone()));
            assert!((0..w * h).all(|i| held.at(i % w, i / w) == ids[(i % w, i / w)]), "{w} x {h}");
            assert_eq!(held.largest(), ids.data().iter().copied().max().unwrap_or(0));
            assert_eq!(held.to_mask().count(), ids.data().iter().filter(|&&id| id != 0).count());
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
