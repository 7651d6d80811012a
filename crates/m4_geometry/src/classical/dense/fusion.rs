//! Merges static depth over the frames: visibility-based fusion of their depth maps (Merrell et al. 2007).

use super::shot::{Pair, Shot};
use super::static_depth::Measured;
use super::working::pixel_at;
use m4_core::Camera;

/// Parallax of the frames that are merged, pixels at the working size: wide ones see past what near ones take for a surface, near ones see
/// what the others do not, and the mean of many has less noise.
pub(super) const PARALLAX_PX: [f64; 10] = [4.0, 6.0, 8.0, 12.0, 17.0, 24.0, 34.0, 48.0, 68.0, 96.0];
/// Disparities that differ by at most this many steps of the sweep are of one surface.
const SAME_STEPS: f32 = 1.0;
/// A frame sees through a surface if it measures this many steps of the sweep behind it.
const THROUGH_STEPS: f32 = 2.0;
/// Sum of the frames' confidences that counts as full confidence.
const FULL: f32 = 4.0;

/// The depth of frame `i` by its own measurement and those of the frames `others`: each pixel takes the nearest surface that no fewer
/// frames hide than see through, the mean of the frames that measured it by their confidence. Pixels without one keep their disparity, with confidence 0.
pub(super) fn fuse(shots: &[Shot], cameras: &[Camera], measured: &[Measured], others: &[usize], i: usize) -> Measured {
    let (w, h) = (shots[i].frame.width, shots[i].frame.height);
    let seen = seen(cameras, measured, others, i, w);
    let pairs: Vec<(usize, Pair)> = others.iter().map(|&j| (j, Pair::new(&cameras[i], &cameras[j]))).collect();
    // whether more than `most` frames see through
    let see_through = |p: usize, disparity: f32, most: usize| {
        let sees = |(j, pair): &&(usize, Pair)| {
            let at = pair.project((p % w) as f32, (p / w) as f32, disparity);
            let behind = at.disparity - THROUGH_STEPS * shots[*j].range.step;
            let q = pixel_at(w, h, at.x, at.y).filter(|_| at.disparity > 0.0);
            q.is_some_and(|q| measured[*j].confidence[q] > 0.0 && measured[*j].disparity[q] < behind)
        };
        pairs.iter().filter(sees).nth(most).is_some()
    };
    let same = SAME_STEPS * shots[i].range.step;
    let mut out = Measured { disparity: measured[i].disparity.clone(), confidence: vec![0.0; w * h] };
    let mut values = Vec::new();
    for (p, seen) in seen.chunks_exact(others.len() + 1).enumerate() {
        values.clear();
        values.extend(seen.iter().copied().filter(|d| d[0] > 0.0));
        values.sort_unstable_by(|a, b| b[0].total_cmp(&a[0]));
        let before = |d: f32| values.iter().take_while(|v| v[0] > d + same).count();
        let Some(&[surface, _]) = values.iter().find(|d| !see_through(p, d[0], before(d[0]))) else { continue };
        let mean = mean_near(&values, surface, same).0;
        let (mean, total) = mean_near(&values, mean, same);
        if total > 0.0 {
            (out.disparity[p], out.confidence[p]) = (mean, (total / FULL).min(1.0));
        }
    }
    out
}

/// Mean of the disparities that differ from `centre` by at most `same`, by their confidence, and the sum of it.
fn mean_near(values: &[[f32; 2]], centre: f32, same: f32) -> (f32, f32) {
    let near = values.iter().filter(|v| (v[0] - centre).abs() <= same);
    let (sum, total) = near.fold((0.0, 0.0), |(sum, total), v| (sum + v[0] * v[1], total + v[1]));
    (sum / f32::max(total, 1e-9), total)
}

/// `[pixel][1 + others]`: the nearest disparity that the frame itself and each of the others measured at a pixel of frame `i`, and its confidence;
/// 0 for none.
fn seen(cameras: &[Camera], measured: &[Measured], others: &[usize], i: usize, width: usize) -> Vec<[f32; 2]> {
    let layers = others.len() + 1;
    let pixels = measured[i].disparity.len();
    let height = pixels / width;
    let mut out = vec![[0.0f32; 2]; pixels * layers];
    let sure = |j: usize| (0..pixels).filter(move |&p| measured[j].confidence[p] > 0.0);
    for p in sure(i) {
        out[p * layers] = [measured[i].disparity[p], measured[i].confidence[p]];
    }
    for (layer, &j) in (1..).zip(others) {
        let pair = Pair::new(&cameras[j], &cameras[i]);
        for p in sure(j) {
            let at = pair.project((p % width) as f32, (p / width) as f32, measured[j].disparity[p]);
            if let Some(q) = pixel_at(width, height, at.x, at.y).filter(|_| at.disparity > 0.0) {
                let nearest = &mut out[q * layers + layer];
                if at.disparity > nearest[0] {
                    *nearest = [at.disparity, measured[j].confidence[p]];
                }
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::{Measured, fuse};
    use crate::classical::dense::shot::Shot;

    /// Measurements of a wall at disparity 2 in seven frames, as `wrong(frame, x)` changes them; 0 is none.
    fn fused(wrong: impl Fn(usize, usize) -> f32) -> (Vec<f32>, Vec<f32>) {
        let (w, h) = (60, 8);
        let (shots, cameras) = Shot::of_wall(7, (w, h), 2.0);
        let measured = |i: usize| {
            let disparity: Vec<f32> = (0..w * h).map(|p| 2.0 * wrong(i, p % w)).collect();
            let confidence = disparity.iter().map(|d| f32::from(u8::from(*d > 0.0))).collect();
            Measured { disparity, confidence }
        };
        let measured: Vec<Measured> = (0..7).map(measured).collect();
        let out = fuse(&shots, &cameras, &measured, &[1, 2, 4, 5], 3);
        let row = 4 * w + 20..4 * w + 40;
        (out.disparity[row.clone()].to_vec(), out.confidence[row].to_vec())
    }

    #[test]
    fn what_others_see_through_goes_and_gaps_are_filled_from_them() {
        let (disparity, confidence) = fused(|i, x| match (i, x) {
            (3, 24..28) => 1.4,
            (3, 32..36) => 0.0,
            _ => 1.0,
        });
        assert!(disparity.iter().all(|d| (d - 2.0).abs() < 1e-3), "{disparity:?}");
        assert!(confidence.iter().all(|c| *c == 1.0), "{confidence:?}");
    }

    #[test]
    fn noise_is_averaged_and_what_none_measured_stays_unknown() {
        let (disparity, _) = fused(|i, _| 1.0 + 0.01 * [0.0, 1.0, -1.0, 1.0, -1.0, 0.0, 0.0][i]);
        assert!(disparity.iter().all(|d| (d - 2.0).abs() < 0.01), "{disparity:?}");
        let (_, confidence) = fused(|_, _| 0.0);
        assert!(confidence.iter().all(|c| *c == 0.0));
    }
}
