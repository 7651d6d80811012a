//! Depth of what does not move: sweep, agreement between frames, fill.

use super::shot::Shot;
use super::sweep::{Partner, aggregate, cost_volume};
use super::working::pixel_at;
use crate::smooth::Smoother;

/// Largest difference to a partner's disparity that counts as agreement, in hypothesis steps.
const AGREE_STEPS: f32 = 1.5;
/// Patches of agreement smaller than this are taken for chance, pixels at the working size.
const LEAST_PATCH_PX: usize = 30;
/// Weight of one sparse point in the fill; a pixel on which all partners agree has 1.
const POINT_WEIGHT: f32 = 4.0;
/// Strength of the edge-aware fill, pixels squared (Min et al. 2014, lambda).
const FILL_LAMBDA: f32 = 900.0;
/// Strength of the last smoothing, pixels squared.
const DENOISE_LAMBDA: f32 = 4.0;

/// A disparity a pixel and how far to trust it.
#[derive(Clone)]
pub(super) struct Measured {
    /// `[height][width]`: mean of the agreeing frames.
    pub disparity: Vec<f32>,
    /// `[height][width]`: share of the partners that agree, 0 where fewer than two do.
    pub confidence: Vec<f32>,
}

/// The disparity of every pixel of one frame, which nothing confirms later on if it has no
/// partners.
pub(super) fn sweep(shots: &[Shot], i: usize) -> Vec<f32> {
    let shot = &shots[i];
    let (w, h) = (shot.frame.width, shot.frame.height);
    let partners: Vec<Partner<'_>> = shot
        .partners
        .iter()
        .map(|(j, pair)| Partner {
            pair: *pair,
            census: &shots[*j].census,
        })
        .collect();
    if partners.is_empty() {
        return vec![shot.range.at(0.5 * shot.range.count as f32); w * h];
    }
    let volume = cost_volume(w, h, &shot.census, &partners, &shot.range);
    let index = aggregate(w, h, shot.range.count, &volume, &shot.frame.grey);
    index.into_iter().map(|k| shot.range.at(k)).collect()
}

/// Keeps what the partners' own sweeps confirm. Moving pixels (`moving[frame]`, above 0) confirm
/// nothing.
pub(super) fn measure(
    shots: &[Shot],
    swept: &[Vec<f32>],
    dynamic: Option<&[Vec<u8>]>,
    i: usize,
) -> Measured {
    let shot = &shots[i];
    let (w, h) = (shot.frame.width, shot.frame.height);
    let mut out = Measured {
        disparity: swept[i].clone(),
        confidence: vec![0.0; w * h],
    };
    let needed = shot.partners.len().min(2);
    if needed == 0 {
        return out;
    }
    for p in (0..w * h).filter(|&p| dynamic.is_none_or(|m| m[i][p] == 0)) {
        let d = swept[i][p];
        let (mut sum, mut agree) = (d, 0usize);
        for (j, pair) in &shot.partners {
            let target = pair.project((p % w) as f32, (p / w) as f32, d);
            let Some(q) = pixel_at(w, h, target.x, target.y).filter(|_| target.disparity > 0.0)
            else {
                continue;
            };
            let difference = swept[*j][q] - target.disparity;
            let tolerance = AGREE_STEPS * shots[*j].range.step;
            if difference.abs() <= tolerance && dynamic.is_none_or(|m| m[*j][q] == 0) {
                sum += d + difference * d / target.disparity;
                agree += 1;
            }
        }
        if agree >= needed {
            out.disparity[p] = sum / (agree + 1) as f32;
            out.confidence[p] = agree as f32 / shot.partners.len() as f32;
        }
    }
    despeckle(w, h, &mut out, 2.0 * shot.range.step);
    out
}

/// Distrusts patches of fewer than [`LEAST_PATCH_PX`] pixels that continue nothing around them:
/// chance agreement.
fn despeckle(width: usize, height: usize, measured: &mut Measured, step: f32) {
    let (disparity, confidence) = (&measured.disparity, &mut measured.confidence);
    let mut visited = vec![false; width * height];
    let (mut open, mut patch) = (Vec::new(), Vec::new());
    for seed in 0..width * height {
        if visited[seed] || confidence[seed] == 0.0 {
            continue;
        }
        patch.clear();
        visited[seed] = true;
        open.push(seed);
        while let Some(i) = open.pop() {
            patch.push(i);
            let (x, y) = (i % width, i / width);
            let neighbours = [
                (x > 0).then(|| i - 1),
                (x + 1 < width).then_some(i + 1),
                y.checked_sub(1).map(|_| i - width),
                (y + 1 < height).then_some(i + width),
            ];
            for n in neighbours.into_iter().flatten() {
                if !visited[n] && confidence[n] > 0.0 && (disparity[n] - disparity[i]).abs() <= step
                {
                    visited[n] = true;
                    open.push(n);
                }
            }
        }
        if patch.len() < LEAST_PATCH_PX {
            for &i in &patch {
                confidence[i] = 0.0;
            }
        }
    }
}

/// A disparity for every pixel: measurements and sparse points where there are any, and between
/// them what the image's edges let through.
///
/// Points within `dynamic` (above 0) are not used: nothing there is static.
pub(super) fn fill(
    shot: &Shot,
    smoother: &Smoother,
    measured: &Measured,
    dynamic: Option<&[u8]>,
) -> Vec<f32> {
    /// Weight of the surroundings against a pixel on which all partners agree.
    const SURROUNDINGS: f32 = 0.15;
    let (mut values, mut weight) = with_points(shot, measured, dynamic);
    // Where nothing at all was measured, the middle of the range is as good as any.
    let anything = 1e-6;
    let middle = shot.range.at(0.3 * shot.range.count as f32);
    for (v, w) in values.iter_mut().zip(&mut weight) {
        *v = (*v * *w + middle * anything) / (*w + anything);
        *w += anything;
    }
    let (surroundings, _) = smoother.fill(&values, &weight, FILL_LAMBDA);
    for ((v, w), s) in values.iter_mut().zip(&mut weight).zip(&surroundings) {
        *v = (*w * *v + SURROUNDINGS * s) / (*w + SURROUNDINGS);
        *w += SURROUNDINGS;
    }
    // Noise goes where the image is flat and stays where it has edges.
    let (mut filled, _) = smoother.fill(&values, &weight, DENOISE_LAMBDA);
    filled
        .iter_mut()
        .for_each(|d| *d = d.max(0.5 * shot.range.least));
    filled
}

/// The same by planes, which cost more, for measurements that are mostly true: surfaces go on with
/// their slope where nothing was measured, and noise is what differs from the planes.
pub(super) fn fill_planes(
    shot: &Shot,
    mut smoother: Smoother,
    measured: &Measured,
    dynamic: Option<&[u8]>,
) -> Vec<f32> {
    /// Weight of the surroundings against a pixel of full confidence.
    const SURROUNDINGS: f32 = 0.02;
    /// Neighbours that differ by more than this are of two surfaces, steps of the sweep.
    const SURFACE_STEPS: f32 = 2.0;
    /// Strength of the smoothing of what differs from the planes, pixels squared: more than where
    /// [`fill`] smooths depth itself, since slopes stay.
    const REST_LAMBDA: f32 = 16.0;
    let (mut values, mut weight) = with_points(shot, measured, dynamic);
    let (least, most) = (
        0.5 * shot.range.least,
        2.0 * shot.range.at(shot.range.count as f32),
    );
    smoother.cut(
        &measured.disparity,
        &measured.confidence,
        SURFACE_STEPS * shot.range.step,
    );
    let mut planes = smoother.planes(&values, &weight, FILL_LAMBDA);
    for ((v, w), plane) in values.iter_mut().zip(&mut weight).zip(&mut planes) {
        *plane = plane.clamp(least, most);
        *v = (*v - *plane) * *w / (*w + SURROUNDINGS);
        *w += SURROUNDINGS;
    }
    let (rest, _) = smoother.fill(&values, &weight, REST_LAMBDA);
    planes
        .iter()
        .zip(&rest)
        .map(|(plane, rest)| (plane + rest).max(least))
        .collect()
}

/// Measurements with the sparse points outside of `dynamic`, and the weight of each.
fn with_points(shot: &Shot, measured: &Measured, dynamic: Option<&[u8]>) -> (Vec<f32>, Vec<f32>) {
    let (mut values, mut weight) = (measured.disparity.clone(), measured.confidence.clone());
    for point in shot
        .points
        .iter()
        .filter(|p| dynamic.is_none_or(|m| m[p.pixel] == 0))
    {
        let total = weight[point.pixel] + POINT_WEIGHT;
        let sum = values[point.pixel] * weight[point.pixel] + point.disparity * POINT_WEIGHT;
        (values[point.pixel], weight[point.pixel]) = (sum / total, total);
    }
    (values, weight)
}
