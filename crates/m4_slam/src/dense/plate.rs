//! Masks against the clean plate: what a pixel would show if nothing moved.
//!
//! Cameras and the depth of what stands still say where a pixel of the background is seen in other frames. Where
//! those frames agree on a colour and the frame at hand shows another, something stands in front of it; where it
//! shows the same, the mask is too wide.

use super::config::{MotionConfig, PlateConfig};
use super::flow::bilinear_rgb;
use super::pair::Pair;
use super::shot::Shot;
use super::smooth::{Smoother, box_blur};
use m4_scene::Camera;

/// Everything that the plates are made of.
pub(super) struct Scene<'a> {
    pub width: usize,
    pub height: usize,
    pub cameras: &'a [Camera],
    pub shots: &'a [Shot],
    /// `[height][width]` by frame: disparity of what stands still, continued behind what moves.
    pub background: &'a [Vec<f32>],
    /// `[height][width]` by frame: above 0 for what may move, generously.
    pub near: &'a [Vec<u8>],
}

/// Pixels within `reach` pixels (in the larger of the two directions) of one above 0.
pub(super) fn grown(width: usize, height: usize, mask: &[u8], reach: usize) -> Vec<u8> {
    let mut rows = vec![0u8; width * height];
    for y in 0..height {
        for x in 0..width {
            let row = &mask[y * width..(y + 1) * width];
            rows[y * width + x] = row[x.saturating_sub(reach)..(x + reach + 1).min(width)]
                .iter()
                .copied()
                .max()
                .unwrap_or(0);
        }
    }
    let mut out = vec![0u8; width * height];
    for y in 0..height {
        for ny in y.saturating_sub(reach)..(y + reach + 1).min(height) {
            for x in 0..width {
                out[y * width + x] = out[y * width + x].max(rows[ny * width + x]);
            }
        }
    }
    out
}

/// The colour of every pixel of `zone` (above 0) if nothing moved, `[height][width]`; `None` where too few frames saw it.
fn plate(scene: &Scene<'_>, i: usize, zone: &[u8], config: &PlateConfig) -> Vec<Option<[f32; 3]>> {
    let (w, h) = (scene.width, scene.height);
    let mut partners = Vec::new();
    for &reach in &config.reaches {
        partners.extend(i.checked_sub(reach));
        partners.extend(Some(i + reach).filter(|&j| j < scene.cameras.len()));
    }
    let pairs: Vec<(usize, Pair)> = partners
        .into_iter()
        .map(|j| (j, Pair::new(&scene.cameras[i], &scene.cameras[j])))
        .collect();
    let mut seen: Vec<[f32; 3]> = Vec::with_capacity(pairs.len());
    (0..w * h)
        .map(|p| {
            if zone[p] == 0 {
                return None;
            }
            seen.clear();
            for (j, pair) in &pairs {
                let at = pair.project((p % w) as f32, (p / w) as f32, scene.background[i][p]);
                let inside =
                    at.disparity > 0.0 && at.x >= 0.0 && at.y >= 0.0 && at.x < (w - 1) as f32 && at.y < (h - 1) as f32;
                if inside && scene.near[*j][(at.y + 0.5) as usize * w + (at.x + 0.5) as usize] == 0 {
                    seen.push(bilinear_rgb(w, h, &scene.shots[*j].frame.rgb, at.x, at.y));
                }
            }
            (seen.len() >= config.least_frames).then(|| std::array::from_fn(|c| median(seen.iter().map(|s| s[c]))))
        })
        .collect()
}

fn median(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: Vec<f32> = values.collect();
    super::shot::quantile(&mut values, 0.5).unwrap_or(0.0)
}

/// Evidence of motion a pixel, above 0 for moving, and its weight.
fn evidence(scene: &Scene<'_>, i: usize, before: &[u8], config: &PlateConfig) -> (Vec<f32>, Vec<f32>) {
    let (w, h) = (scene.width, scene.height);
    let zone = grown(w, h, &scene.near[i], config.margin_px);
    let plate = plate(scene, i, &zone, config);
    let frame = &scene.shots[i].frame;
    // Shadows keep the pattern of what they fall on: the plate may be darker by one factor around a pixel.
    let level = |rgb: [f32; 3]| rgb[0] + rgb[1] + rgb[2];
    let mut here: Vec<f32> = (0..w * h)
        .map(|p| plate[p].map_or(0.0, |_| level(frame.rgb[p].map(f32::from))))
        .collect();
    let mut there: Vec<f32> = (0..w * h).map(|p| plate[p].map_or(0.0, level)).collect();
    box_blur(w, h, &mut here);
    box_blur(w, h, &mut there);
    let (mut value, mut weight) = (vec![0.0; w * h], vec![0.0; w * h]);
    for p in 0..w * h {
        let Some(still) = plate[p] else { continue };
        let rgb = frame.rgb[p].map(f32::from);
        let gain = (here[p] / there[p].max(1.0)).clamp(config.least_gain, 1.0);
        let off = |g: f32| (0..3).map(|c| (rgb[c] - g * still[c]).abs()).fold(0.0, f32::max);
        value[p] = off(1.0).min(off(gain) + config.gain_cost * (1.0 - gain));
        weight[p] = 1.0;
    }
    let mut total = weight.clone();
    box_blur(w, h, &mut value);
    box_blur(w, h, &mut total);
    for p in 0..w * h {
        if weight[p] > 0.0 {
            let step = if before[p] > 0 {
                config.step
            } else {
                config.step_outside
            };
            value[p] = ((value[p] / total[p].max(1e-6)) / step - 1.0).clamp(-1.0, 1.0);
        }
    }
    (value, weight)
}

/// The mask of a frame, from `before` (its mask so far) and the plate.
pub(super) fn sharpen(
    scene: &Scene<'_>,
    i: usize,
    before: &[u8],
    smoother: &Smoother,
    motion: &MotionConfig,
    config: &PlateConfig,
) -> Vec<u8> {
    let (mut value, mut weight) = evidence(scene, i, before, config);
    for p in 0..value.len() {
        let prior = if before[p] > 0 { config.prior } else { -config.prior };
        value[p] = value[p] * weight[p] + prior;
        weight[p] += config.prior.max(1e-3);
        value[p] /= weight[p];
    }
    let smooth = smoother.fill(&value, &weight, config.smooth_lambda).0;
    super::motion::mask(scene.width, scene.height, &smooth, motion)
}
