//! Depth as the network takes it: in its size, with edges of objects taken from beside them, and
//! the range that counts.

use super::frame::PosedPinhole;
use crate::ops::{Kernels, resampled};
use m4_core::DepthMap;
use rayon::prelude::*;

/// Depth may vary by this share of itself among neighbours before it is an edge...
const JUMP: f32 = 0.08;
/// ... if normals turn by more than this, too.
const TURN_DEGREES: f64 = 15.0;

/// `depth` in `size`: the mean of what is known around each pixel. 0 where nothing is.
pub fn resized(depth: &DepthMap, size: (usize, usize)) -> Vec<f32> {
    let (w, h) = depth.size();
    let z: Vec<f32> = depth.data().iter().map(|&z| depth_in_range(z)).collect();
    if (w, h) == size {
        return z;
    }
    let coverage: Vec<f32> = z.iter().map(|&z| f32::from(z > 0.0)).collect();
    let (columns, rows) = (Kernels::linear(w, size.0), Kernels::linear(h, size.1));
    let coverage = resampled(&coverage, w, h, &columns, &rows);
    let mut z = resampled(&z, w, h, &columns, &rows);
    for (z, coverage) in z.iter_mut().zip(coverage) {
        *z = if coverage > 1e-6 {
            *z / (coverage + 1e-6)
        } else {
            0.0
        };
    }
    z
}

fn depth_in_range(z: f32) -> f32 {
    if z > 0.0 && z < FARTHEST { z } else { 0.0 }
}

/// Depth beyond this is taken for none.
const FARTHEST: f32 = 1e9;

type Vec3 = [f64; 3];

fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn unit(a: Vec3) -> Vec3 {
    let length = (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]).sqrt() + 1e-12;
    a.map(|x| x / length)
}

/// The places `(x, y)` of the window of three by three pixels around one, as far as they are in an
/// image of `w` by `h`.
fn window(x: usize, y: usize, w: usize, h: usize) -> impl Iterator<Item = usize> {
    let columns = x.saturating_sub(1)..(x + 2).min(w);
    (y.saturating_sub(1)..(y + 2).min(h)).flat_map(move |y| columns.clone().map(move |x| y * w + x))
}

/// `z` `[h][w]` with depth at edges replaced by that of the nearest pixel that is known and no
/// edge.
pub fn cleaned(z: &[f32], (w, h): (usize, usize), lens: &PosedPinhole) -> Vec<f32> {
    let steps = map(w, h, |x, y| {
        let at = y * w + x;
        let near = || window(x, y, w, h).map(|i| z[i]).filter(|&z| z > 0.0);
        let (low, high) = near().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), z| {
            (low.min(z), high.max(z))
        });
        z[at] > 0.0 && (high - low) / z[at] > JUMP
    });
    if !steps.contains(&true) {
        return z.to_vec();
    }
    let normals = map(w, h, |x, y| normal(z, w, h, lens, x, y));
    let least = TURN_DEGREES.to_radians().cos();
    let turns = map(w, h, |x, y| {
        let (n, _) = normals[y * w + x];
        let n = unit(n);
        // edges repeat the pixel itself, which never turns
        window(x, y, w, h).any(|i| {
            let (other, valid) = normals[i];
            let other = unit(other);
            valid && n[0] * other[0] + n[1] * other[1] + n[2] * other[2] < least
        })
    });
    let edges = map(w, h, |x, y| {
        steps[y * w + x] && window(x, y, w, h).any(|i| turns[i])
    });
    let sound: Vec<bool> = z
        .iter()
        .zip(&edges)
        .map(|(&z, &edge)| z > 0.0 && !edge)
        .collect();
    let nearest = nearest_pixels(&sound, w, h);
    let replaced = |i: usize| {
        if edges[i] {
            nearest[i].map_or(z[i], |j| z[j])
        } else {
            z[i]
        }
    };
    (0..w * h).map(replaced).collect()
}

fn map<T: Send>(w: usize, h: usize, f: impl Fn(usize, usize) -> T + Sync) -> Vec<T> {
    (0..h)
        .into_par_iter()
        .flat_map_iter(|y| (0..w).map(move |x| (x, y)))
        .map(|(x, y)| f(x, y))
        .collect()
}

/// The normal at a pixel, the mean of those of its four corners, and whether one of these is known.
fn normal(z: &[f32], w: usize, h: usize, lens: &PosedPinhole, x: usize, y: usize) -> (Vec3, bool) {
    let point = |dx: isize, dy: isize| -> Option<Vec3> {
        let (x, y) = (x.checked_add_signed(dx)?, y.checked_add_signed(dy)?);
        let depth = (x < w && y < h)
            .then(|| z[y * w + x])
            .filter(|&z| z > 0.0)?;
        Some(lens.ray([x as f64, y as f64]).map(|r| r * f64::from(depth)))
    };
    let none = ([0.0; 3], false);
    let Some(here) = point(0, 0) else {
        return none;
    };
    let around = [(0, -1), (-1, 0), (0, 1), (1, 0)].map(|(dx, dy)| {
        let neighbour = point(dx, dy)?;
        Some([0, 1, 2].map(|i| neighbour[i] - here[i]))
    });
    let mut sum = [0.0; 3];
    let mut any = false;
    for k in 0..4 {
        if let (Some(a), Some(b)) = (around[k], around[(k + 1) % 4]) {
            let n = unit(cross(a, b));
            (0..3).for_each(|i| sum[i] += n[i]);
            any = true;
        }
    }
    if any { (unit(sum), true) } else { none }
}

/// How often depths occur, in steps of one part in 65,536 of themselves.
#[derive(Debug)]
pub struct Histogram {
    counts: Vec<u64>,
    total: u64,
}

/// Depths are distinguished by these bits of theirs: the exponent and 16 bits of the fraction.
const DROPPED_BITS: u32 = 7;
/// Sign and exponent of the least and the largest depth that are distinguished, 2^-40 and 2^40.
const EXPONENTS: (u32, u32) = (127 - 40, 127 + 40);

impl Histogram {
    pub fn new() -> Self {
        let bins = (EXPONENTS.1 - EXPONENTS.0) << (23 - DROPPED_BITS);
        Self {
            counts: vec![0; bins as usize],
            total: 0,
        }
    }

    /// Takes in the known ones of `depths`.
    pub fn add(&mut self, depths: &[f32]) {
        let first = EXPONENTS.0 << (23 - DROPPED_BITS);
        for z in depths.iter().filter(|&&z| z > 0.0) {
            let bin = (z.to_bits() >> DROPPED_BITS).saturating_sub(first) as usize;
            let last = self.counts.len() - 1;
            self.counts[bin.min(last)] += 1;
            self.total += 1;
        }
    }

    /// The `k`-th smallest depth, counted from 1.
    fn value(&self, k: u64) -> f64 {
        let first = EXPONENTS.0 << (23 - DROPPED_BITS);
        let mut before = 0;
        let bin = self.counts.iter().position(|count| {
            before += count;
            before >= k
        });
        let bits = (first + bin.unwrap_or(0) as u32) << DROPPED_BITS;
        f64::from(f32::from_bits(bits + (1 << (DROPPED_BITS - 1))))
    }

    /// The depths that count: up to the third quartile and one and a half times what lies between
    /// it and the first. `None` if no depth is known.
    pub fn range(&self) -> Option<[f32; 2]> {
        (self.total > 0).then(|| {
            let quartile = |share: f64| self.value(((share * self.total as f64) as u64).max(1));
            let (low, high) = (quartile(0.25), quartile(0.75));
            [1e-7, (high + 1.5 * (high - low)) as f32]
        })
    }
}

/// In time that goes with the pixels (Meijster et al., "A General Algorithm for Computing Distance
/// Transforms in Linear Time", 2000): for each pixel of an image of `w` by `h` the nearest one that
/// is `in_set`; `None` if there is none.
pub fn nearest_pixels(in_set: &[bool], w: usize, h: usize) -> Vec<Option<usize>> {
    let rows = nearest_in_columns(in_set, w, h);
    let mut out = vec![None; w * h];
    if w == 0 {
        return out;
    }
    out.par_chunks_mut(w)
        .zip(rows.par_chunks(w))
        .enumerate()
        .for_each(|(y, (out, rows))| along_row(out, rows, y, w));
    out
}

/// For each pixel the row of the nearest one in its column.
fn nearest_in_columns(in_set: &[bool], w: usize, h: usize) -> Vec<Option<usize>> {
    let mut rows: Vec<Option<usize>> = vec![None; w * h];
    for y in 0..h {
        for x in 0..w {
            let above = if y > 0 { rows[(y - 1) * w + x] } else { None };
            rows[y * w + x] = if in_set[y * w + x] { Some(y) } else { above };
        }
    }
    for y in (0..h.saturating_sub(1)).rev() {
        for x in 0..w {
            let below = rows[(y + 1) * w + x];
            let near = |row: Option<usize>| row.map_or(usize::MAX, |row| row.abs_diff(y));
            if near(below) < near(rows[y * w + x]) {
                rows[y * w + x] = below;
            }
        }
    }
    rows
}

/// The lower envelope of the parabolas that the columns' distances are.
fn along_row(out: &mut [Option<usize>], rows: &[Option<usize>], y: usize, w: usize) {
    let height = |x: usize| rows[x].map(|row| (row.abs_diff(y) as f64).powi(2));
    // columns whose parabola is lowest somewhere, and where that begins
    let mut columns: Vec<(usize, f64)> = Vec::new();
    for x in 0..w {
        let Some(g) = height(x) else { continue };
        let mut from = f64::NEG_INFINITY;
        while let Some(&(other, begins)) = columns.last() {
            let (a, b) = (other as f64, x as f64);
            let g_other = height(other).unwrap_or(f64::INFINITY);
            from = ((b * b + g) - (a * a + g_other)) / (2.0 * (b - a));
            if from > begins {
                break;
            }
            columns.pop();
            from = f64::NEG_INFINITY;
        }
        columns.push((x, from));
    }
    let mut k = 0;
    for (x, out) in out.iter_mut().enumerate() {
        while columns
            .get(k + 1)
            .is_some_and(|&(_, begins)| begins < x as f64)
        {
            k += 1;
        }
        *out = columns
            .get(k)
            .and_then(|&(column, _)| rows[column].map(|row| row * w + column));
    }
}

#[cfg(test)]
mod tests {
    use super::{nearest_pixels, *};
    use m4_core::Plane;

    #[test]
    fn quartiles_are_those_of_sorting() {
        let mut depths: Vec<f32> = (0..4001)
            .map(|i| 0.3 + ((i * 7919) % 4001) as f32 * 0.01)
            .collect();
        let mut histogram = Histogram::new();
        depths.push(0.0);
        depths.push(f32::NAN);
        depths.chunks(100).for_each(|some| histogram.add(some));
        assert_eq!(histogram.total, 4001);
        let mut sorted = depths[..4001].to_vec();
        sorted.sort_by(f32::total_cmp);
        let (low, high) = (sorted[1000 - 1], sorted[3000 - 1]);
        let want = high + 1.5 * (high - low);
        let [least, most] = histogram.range().unwrap();
        assert!(
            least == 1e-7 && (most / want - 1.0).abs() < 5e-5,
            "{most} for {want}"
        );
        assert_eq!(Histogram::new().range(), None);
        histogram.add(&[1e-30, 1e30, f32::MIN_POSITIVE, f32::MAX]);
        assert_eq!(histogram.total, 4005);
    }

    #[test]
    fn unknown_depth_does_not_bleed_into_known_pixels() {
        let depth = Plane::from_fn(8, 6, |x, _| if x < 4 { 2.0 } else { f32::NAN });
        let z = resized(&depth, (16, 12));
        for (i, z) in z.iter().enumerate() {
            let x = i % 16;
            if x <= 8 {
                assert!((z - 2.0).abs() < 1e-4, "{x}: {z}");
            } else {
                assert_eq!(*z, 0.0, "{x}");
            }
        }
    }

    #[test]
    fn agrees_with_looking_at_all() {
        let (w, h) = (23, 17);
        for step in [3, 7, 29, 101, 1000] {
            let set: Vec<bool> = (0..w * h).map(|i| (i * i * 31 + 5) % step == 1).collect();
            let got = nearest_pixels(&set, w, h);
            let square = |i: usize, j: usize| {
                (i % w).abs_diff(j % w).pow(2) + (i / w).abs_diff(j / w).pow(2)
            };
            for (i, got) in got.iter().enumerate() {
                let want = (0..w * h).filter(|&j| set[j]).map(|j| square(i, j)).min();
                assert_eq!(got.map(|j| square(i, j)), want, "{i}");
                assert!(got.is_none_or(|j| set[j]));
            }
        }
        assert!(nearest_pixels(&[], 0, 0).is_empty());
    }
}
