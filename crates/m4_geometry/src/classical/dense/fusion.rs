//! Merges static depth over the frames: visibility-based fusion of their depth maps (Merrell et al.
//! 2007).

use super::shot::{Pair, Shot};
use super::static_depth::Measured;
use super::working::pixel_at;
use m4_core::{Camera, bilinear_cell};

/// Parallax of the frames that are merged, pixels at the working size: wide ones see past what near
/// ones take for a surface, near ones see what the others do not, and the mean of many has less
/// noise.
pub(super) const PARALLAX_PX: [f64; 10] = [4.0, 6.0, 8.0, 12.0, 17.0, 24.0, 34.0, 48.0, 68.0, 96.0];
/// Disparities that differ by at most this many steps of the sweep are of one surface.
const SAME_STEPS: f32 = 1.0;
/// A frame sees through a surface if it measures this many steps of the sweep behind it.
const THROUGH_STEPS: f32 = 1.0;
/// Sum of the frames' confidences that counts as full confidence.
const FULL: f32 = 4.0;

/// `[height][width]`: disparity of a frame and its confidence, 0 where it was not measured.
pub(super) type DepthMap = Vec<(f32, f32)>;

/// The depth of frame `i` by its own `measured` depth and that of the frames `others`: each pixel
/// takes the nearest surface that no fewer frames hide than see through, the mean of the frames
/// that measured it by their confidence. Pixels without one keep their disparity, with confidence
/// 0.
pub(super) fn fuse(
    shots: &[Shot],
    cameras: &[Camera],
    measured: &[DepthMap],
    others: &[usize],
    i: usize,
) -> Measured {
    let size = (shots[i].frame.width, shots[i].frame.height);
    let (w, h) = size;
    let disparities = disparities_at(cameras, measured, others, i, w);
    let others: Vec<Other<'_>> = others
        .iter()
        .map(|&j| {
            let through = THROUGH_STEPS * shots[j].range.step;
            Other {
                size,
                pair: Pair::new(&cameras[i], &cameras[j]),
                depth: &measured[j],
                through,
            }
        })
        .collect();
    let same = SAME_STEPS * shots[i].range.step;
    let mut out = Measured {
        disparity: measured[i].iter().map(|d| d.0).collect(),
        confidence: vec![0.0; w * h],
    };
    let mut values = Vec::new();
    for (p, candidates) in disparities.chunks_exact(others.len() + 1).enumerate() {
        values.clear();
        values.extend(candidates.iter().copied().filter(|d| *d > 0.0));
        values.sort_unstable_by(|a, b| b.total_cmp(a));
        let at = [(p % w) as f32, (p / w) as f32];
        let hidden = |d: f32| values.iter().take_while(|v| **v > d + same).count();
        let seen_through = |d: f32| {
            others
                .iter()
                .filter(|other| other.sees_through(at, d))
                .nth(hidden(d))
                .is_some()
        };
        let Some(&surface) = values.iter().find(|d| !seen_through(**d)) else {
            continue;
        };
        // the nearest of several is too near: what lies around it is the place to begin
        let start = mean(
            values
                .iter()
                .map(|v| (*v, 1.0))
                .filter(|v| (v.0 - surface).abs() <= same),
        )
        .0;
        let own = Some(measured[i][p]).filter(|own| (own.0 - start).abs() <= same);
        let (disparity, total) = mean(
            own.into_iter()
                .chain(others.iter().flat_map(|o| o.near(at, start, same))),
        );
        if total > 0.0 {
            (out.disparity[p], out.confidence[p]) = (disparity, (total / FULL).min(1.0));
        }
    }
    out
}

/// Weighted mean of values, and the sum of their weights.
fn mean(values: impl Iterator<Item = (f32, f32)>) -> (f32, f32) {
    let (sum, total) = values.fold((0.0, 0.0), |(sum, total), (v, weight)| {
        (sum + weight * v, total + weight)
    });
    (sum / f32::max(total, 1e-9), total)
}

/// A frame whose depth is merged into another.
struct Other<'a> {
    size: (usize, usize),
    /// From the pixels of the other frame to those of this one.
    pair: Pair,
    depth: &'a DepthMap,
    /// How far behind a surface a measurement must lie to see through it, disparity.
    through: f32,
}

impl Other<'_> {
    /// Whether it measured something well behind `disparity` at a place of the other frame.
    fn sees_through(&self, [x, y]: [f32; 2], disparity: f32) -> bool {
        let target = self.pair.project(x, y, disparity);
        let q = pixel_at(self.size.0, self.size.1, target.x, target.y)
            .filter(|_| target.disparity > 0.0);
        q.is_some_and(|q| {
            self.depth[q].1 > 0.0 && self.depth[q].0 < target.disparity - self.through
        })
    }

    /// Disparities within `same` of `disparity` in the four pixels around that place, as the other
    /// frame sees them, and the weights of bilinear interpolation times their confidences. Pixels
    /// rounded to whole ones would be off by half a pixel of slope, and the nearest of several too
    /// near.
    fn near(
        &self,
        [x, y]: [f32; 2],
        disparity: f32,
        same: f32,
    ) -> impl Iterator<Item = (f32, f32)> {
        let (w, h) = self.size;
        let target = self.pair.project(x, y, disparity);
        let (right, bottom) = ((w - 1) as f32, (h - 1) as f32);
        let inside = target.disparity > 0.0
            && (0.0..right).contains(&target.x)
            && (0.0..bottom).contains(&target.y);
        let (q, wx, wy) = bilinear_cell(w, h, target.x, target.y);
        let corners = if inside {
            [
                (q, 1.0 - wx, 1.0 - wy),
                (q + 1, wx, 1.0 - wy),
                (q + w, 1.0 - wx, wy),
                (q + w + 1, wx, wy),
            ]
        } else {
            [(0, 0.0, 0.0); 4]
        };
        let unit = disparity / target.disparity;
        corners.into_iter().filter_map(move |(q, wx, wy)| {
            let (theirs, confidence) = self.depth[q];
            let difference = (theirs - target.disparity) * unit;
            (difference.abs() <= same).then_some((disparity + difference, wx * wy * confidence))
        })
    }
}

/// `[pixel][1 + others]`: the nearest disparity that the frame itself and each of the others
/// measured at a pixel of frame `i`; 0 for none.
fn disparities_at(
    cameras: &[Camera],
    measured: &[DepthMap],
    others: &[usize],
    i: usize,
    width: usize,
) -> Vec<f32> {
    let layers = others.len() + 1;
    let pixels = measured[i].len();
    let height = pixels / width;
    let mut out = vec![0.0f32; pixels * layers];
    let sure = |j: usize| {
        measured[j]
            .iter()
            .enumerate()
            .filter(|(_, d)| d.1 > 0.0)
            .map(|(p, d)| (p, d.0))
    };
    for (p, disparity) in sure(i) {
        out[p * layers] = disparity;
    }
    for (layer, &j) in (1..).zip(others) {
        let pair = Pair::new(&cameras[j], &cameras[i]);
        for (p, disparity) in sure(j) {
            let at = pair.project((p % width) as f32, (p / width) as f32, disparity);
            if let Some(q) = pixel_at(width, height, at.x, at.y).filter(|_| at.disparity > 0.0) {
                let nearest = &mut out[q * layers + layer];
                *nearest = nearest.max(at.disparity);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::{DepthMap, fuse};
    use crate::classical::dense::shot::Shot;

    /// Measurements of a wall at disparity 2 in seven frames, as `wrong(frame, x)` changes them; 0
    /// is none.
    fn fused(wrong: impl Fn(usize, usize) -> f32) -> (Vec<f32>, Vec<f32>) {
        let (w, h) = (60, 8);
        let (shots, cameras) = Shot::of_wall(7, (w, h), 2.0);
        let measurement = |d: f32| (d, f32::from(u8::from(d > 0.0)));
        let measured = |i: usize| {
            (0..w * h)
                .map(|p| measurement(2.0 * wrong(i, p % w)))
                .collect()
        };
        let measured: Vec<DepthMap> = (0..7).map(measured).collect();
        let out = fuse(&shots, &cameras, &measured, &[1, 2, 4, 5], 3);
        let row = 4 * w + 20..4 * w + 40;
        (
            out.disparity[row.clone()].to_vec(),
            out.confidence[row].to_vec(),
        )
    }

    #[test]
    fn what_others_see_through_goes_and_gaps_are_filled_from_them() {
        let (disparity, confidence) = fused(|i, x| match (i, x) {
            (3, 24..28) => 1.4,
            (3, 32..36) => 0.0,
            _ => 1.0,
        });
        assert!(
            disparity.iter().all(|d| (d - 2.0).abs() < 1e-3),
            "{disparity:?}"
        );
        assert!(confidence.iter().all(|c| *c == 1.0), "{confidence:?}");
    }

    #[test]
    fn depth_of_a_slanted_wall_is_taken_between_the_pixels_of_other_frames() {
        let (w, h) = (60, 8);
        let (shots, cameras) = Shot::of_wall(7, (w, h), 2.0);
        // 1 / z = slope x + 2 in the first frame; cameras go to the right by one unit per frame, at
        // a focal length of one pixel
        let slope = 0.012;
        let truth =
            |i: usize, x: usize| (2.0 + slope * (x as f32 - 29.5)) / (1.0 - slope * i as f32);
        let wall = |i: usize| (0..w * h).map(|p| (truth(i, p % w), 1.0)).collect();
        let measured: Vec<DepthMap> = (0..7).map(wall).collect();
        // frames of one side: errors of rounding do not cancel
        let out = fuse(&shots, &cameras, &measured, &[0, 1, 2], 3);
        for x in 15..45 {
            let error = out.disparity[4 * w + x] / truth(3, x) - 1.0;
            assert!(error.abs() < 1e-4, "column {x}: {error}");
        }
    }

    #[test]
    fn noise_is_averaged_and_what_none_measured_stays_unknown() {
        let (disparity, _) = fused(|i, _| 1.0 + 0.01 * [0.0, 1.0, -1.0, 1.0, -1.0, 0.0, 0.0][i]);
        assert!(
            disparity.iter().all(|d| (d - 2.0).abs() < 0.01),
            "{disparity:?}"
        );
        let (_, confidence) = fused(|_, _| 0.0);
        assert!(confidence.iter().all(|c| *c == 0.0));
    }
}
