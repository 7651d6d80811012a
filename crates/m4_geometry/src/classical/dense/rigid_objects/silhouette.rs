//! What the outline of a part shows in each frame: where its middle is, whether all of it is
//! visible, and how near it is in one frame against another.

use super::{Tracklet, WorkingClip};
use m4_core::quantile;
use nalgebra::Vector2;

/// A part with less than this share of its area in the frames around is partly hidden.
const COMPLETE: f64 = 0.75;
/// Time around a frame that tells how large a part usually is, on each side, seconds.
const AROUND_S: f64 = 1.0 / 6.0;
/// A part that shares more than this of its outline with another may be behind it.
const SHARED: f64 = 0.08;
/// Deviation of the logarithm of the size in the image, over that by distance, of parts that turn
/// and of imperfect masks: measured 0.03 to 0.1.
const SIZE_SIGMA: f32 = 0.12;
/// Deviations count up to this.
const MOST_DEVIATION: f32 = 0.5;

/// A part in one frame.
pub(super) struct Silhouette {
    /// Mean pixel coordinates.
    pub middle: Vector2<f64>,
    /// Number of pixels.
    pub area: usize,
    /// All of the part is in the image and nothing is in front of it, as far as one can tell.
    pub complete: bool,
}

/// Radius of a disc of an area, pixels.
pub(super) fn radius_px(area: usize) -> f64 {
    (area as f64 / std::f64::consts::PI).sqrt()
}

/// By frame of the tracklet.
pub(super) fn silhouettes(clip: &WorkingClip<'_>, tracklet: &Tracklet) -> Vec<Silhouette> {
    let area: Vec<usize> = tracklet.parts.iter().map(Vec::len).collect();
    let reach = clip.rate.frames(AROUND_S);
    let mut own = vec![false; clip.width * clip.height];
    (0..area.len())
        .map(|k| {
            let (middle, clear) = outline(clip, tracklet, k, &mut own);
            let around = &area[k.saturating_sub(reach)..(k + reach + 1).min(area.len())];
            let usual = around.iter().copied().max().unwrap_or(0) as f64;
            Silhouette {
                middle,
                area: area[k],
                complete: clear && area[k] as f64 > COMPLETE * usual,
            }
        })
        .collect()
}

/// Pixel coordinates of the middle of a part, and whether it touches neither the border of the
/// image nor, for long, another part; `own` is room to work in, all false before and after.
fn outline(
    clip: &WorkingClip<'_>,
    tracklet: &Tracklet,
    k: usize,
    own: &mut [bool],
) -> (Vector2<f64>, bool) {
    let (w, h) = (clip.width, clip.height);
    let (pixels, dynamic) = (&tracklet.parts[k], &clip.dynamic[tracklet.first + k]);
    for &p in pixels {
        own[p as usize] = true;
    }
    let (mut sum, mut border) = (Vector2::zeros(), false);
    let (mut edge, mut shared) = (0usize, 0usize);
    for &p in pixels {
        let p = p as usize;
        let (x, y) = (p % w, p / w);
        sum += Vector2::new(x as f64, y as f64);
        if x < 2 || y < 2 || x + 3 > w || y + 3 > h {
            border = true;
            continue;
        }
        let next = [p - 1, p + 1, p - w, p + w];
        edge += usize::from(next.iter().any(|&n| !own[n]));
        shared += usize::from(next.iter().any(|&n| !own[n] && dynamic[n] > 0));
    }
    for &p in pixels {
        own[p as usize] = false;
    }
    (
        sum / pixels.len().max(1) as f64,
        !border && (shared as f64) < SHARED * edge as f64,
    )
}

/// By frame, the factor on the disparities suggested by contact, `[frames][grid]` (0 outside of the
/// part), that moves them towards one size of the part in all frames in which it is complete. Of
/// geometric mean 1; between these frames it changes evenly in ratios.
///
/// A standing part has the size that its contact says, but for errors of the outline. One that
/// hovers or flies has not: the distance of the ground under it changes, its size does not. So the
/// factors count the more, the more the two differ.
pub(super) fn one_size(
    clip: &WorkingClip<'_>,
    tracklet: &Tracklet,
    disparity: &[Vec<f32>],
) -> Vec<f32> {
    let ratios: Vec<Option<f32>> = silhouettes(clip, tracklet)
        .iter()
        .zip(disparity)
        .map(|(silhouette, disparity)| {
            let mut values: Vec<f32> = disparity.iter().copied().filter(|d| *d > 0.0).collect();
            let typical = quantile(&mut values, 0.5)?;
            let size = (silhouette.area as f32).sqrt();
            silhouette.complete.then_some(size / typical)
        })
        .collect();
    let mut factors = vec![1.0; disparity.len()];
    between(&ratios, &mut factors);
    let mut logs: Vec<f32> = ratios.iter().flatten().map(|r| r.ln()).collect();
    let Some(middle) = quantile(&mut logs, 0.5) else {
        return factors;
    };
    let off = |l: &f32| (l - middle).abs().min(MOST_DEVIATION).powi(2);
    let variance = logs.iter().map(off).sum::<f32>() / logs.len() as f32;
    let share = variance / (variance + SIZE_SIGMA * SIZE_SIGMA);
    let mean = factors.iter().map(|f| f.ln()).sum::<f32>() / factors.len() as f32;
    factors
        .iter_mut()
        .for_each(|f| *f = (share * (f.ln() - mean)).exp());
    factors
}

/// Fills what is not known between what is, evenly in ratios, and carries the first and the last
/// on.
fn between(factors: &[Option<f32>], out: &mut [f32]) {
    let at: Vec<(usize, f32)> = factors
        .iter()
        .enumerate()
        .filter_map(|(k, v)| v.map(|v| (k, v)))
        .collect();
    for (k, out) in out.iter_mut().enumerate() {
        let next = at.partition_point(|(i, _)| *i < k);
        let (before, after) = (next.checked_sub(1).and_then(|i| at.get(i)), at.get(next));
        *out = match (before, after) {
            (Some(&(i, a)), Some(&(j, b))) => a * (b / a).powf((k - i) as f32 / (j - i) as f32),
            (Some(&(_, v)), None) | (None, Some(&(_, v))) => v,
            (None, None) => *out,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::{Tracklet, one_size, silhouettes};
    use crate::classical::dense::working::ClipData;

    const W: usize = 50;
    const H: usize = 40;

    /// A square of a side by frame, and what it hides and is hidden by.
    fn clip(sides: &[usize]) -> (ClipData, Tracklet) {
        let part = |side: &usize| -> Vec<u32> {
            let inside = |p: &u32| {
                let (x, y) = (*p as usize % W, *p as usize / W);
                (5..5 + side).contains(&x) && (5..5 + side).contains(&y)
            };
            (0..(W * H) as u32).filter(inside).collect()
        };
        let parts: Vec<Vec<u32>> = sides.iter().map(part).collect();
        let mask = |part: &Vec<u32>| {
            let mut mask = vec![0u8; W * H];
            part.iter().for_each(|p| mask[*p as usize] = 255);
            mask
        };
        let data = ClipData {
            size: (W, H),
            cameras: Vec::new(),
            dynamic: parts.iter().map(mask).collect(),
            disparity: Vec::new(),
            flows: Vec::new(),
        };
        (data, Tracklet { first: 0, parts })
    }

    #[test]
    fn a_part_of_one_size_keeps_it_though_the_ground_under_it_changes() {
        // It comes nearer by a quarter, the ground under it says that it goes away.
        let sides: Vec<usize> = (0..18).map(|k| 20 + k / 3).collect();
        let (data, tracklet) = clip(&sides);
        let ground: Vec<Vec<f32>> = (0..18).map(|k| vec![1.0 - 0.03 * k as f32; 4]).collect();
        let factors = one_size(&data.clip(), &tracklet, &ground);
        let path: Vec<f32> = factors.iter().zip(&ground).map(|(f, g)| f * g[0]).collect();
        let grows = path[17] / path[0];
        assert!((1.0..1.3).contains(&grows), "{path:?}");
        let mean: f32 = factors.iter().map(|f| f.ln()).sum();
        assert!(mean.abs() < 1e-4, "{mean}");
    }

    #[test]
    fn contact_that_agrees_with_the_size_is_hardly_changed() {
        let (data, tracklet) = clip(&[12, 12, 13, 12, 12, 13]);
        let ground = vec![vec![0.0, 1.0, 1.0]; 6];
        let factors = one_size(&data.clip(), &tracklet, &ground);
        assert!(
            factors.iter().all(|f| (f - 1.0).abs() < 0.01),
            "{factors:?}"
        );
    }

    #[test]
    fn a_part_at_the_border_or_beside_another_is_not_complete() {
        let (mut data, mut tracklet) = clip(&[10, 10, 10]);
        tracklet.parts[0].insert(0, 0);
        for y in 5..15 {
            data.dynamic[1][y * W + 15] = 255;
        }
        let complete: Vec<bool> = silhouettes(&data.clip(), &tracklet)
            .iter()
            .map(|s| s.complete)
            .collect();
        assert_eq!(complete, [false, false, true]);
    }
}
