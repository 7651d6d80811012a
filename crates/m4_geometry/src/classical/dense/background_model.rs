//! Masks against the clean background: what a pixel would show if nothing moved.
//!
//! Cameras and the depth of static regions say where a pixel of the background is seen in other frames. Where
//! those frames agree on a colour and the frame at hand shows another, something stands in front of it; where it
//! shows the same, the mask is too wide.

use super::flow::bilinear_rgb;
use super::pair::Pair;
use super::shot::Shot;
use super::smooth::{Smoother, box_blur};
use m4_core::{Camera, dilated};

/// Distances in time of the frames that a background is made of, each both ways.
const REACHES: [usize; 5] = [2, 5, 9, 14, 20];
/// Fewest frames that must have seen a pixel of the background.
const LEAST_FRAMES: usize = 2;
/// How far a region may reach beyond its mask, pixels at the working size.
const MARGIN_PX: usize = 6;
/// How far masks are grown before pixels of other frames count as background, pixels.
pub(super) const GUARD_PX: usize = 2;
/// Difference in colour (0..255, mean of 5x5 pixels) that is as likely motion as not, inside the previous mask.
const STEP: f32 = 20.0;
/// The same outside of the previous mask.
const STEP_OUTSIDE: f32 = 32.0;
/// Darkest shadow, as a share of the light.
const LEAST_GAIN: f32 = 0.4;
/// Cost of explaining a difference by a shadow, 0..255 for full darkness.
const GAIN_COST: f32 = 20.0;
/// Weight of the previous mask; a pixel of the background has 1.
const PRIOR: f32 = 0.3;
/// Strength of the edge-aware smoothing, pixels squared (Min et al. 2014, lambda).
const SMOOTH_LAMBDA: f32 = 10.0;

/// Everything that the plates are made of.
pub(super) struct Scene<'a> {
    pub width: usize,
    pub height: usize,
    pub cameras: &'a [Camera],
    pub shots: &'a [Shot],
    /// `[height][width]` by frame: disparity of static regions, continued behind dynamic ones.
    pub background: &'a [Vec<f32>],
    /// `[height][width]` by frame: above 0 for what may move, generously.
    pub near: &'a [Vec<u8>],
}

/// The colour of every pixel of `zone` (above 0) if nothing moved, `[height][width]`; `None` where too few frames saw it.
fn background_colours(scene: &Scene<'_>, i: usize, zone: &[u8]) -> Vec<Option<[f32; 3]>> {
    let (w, h) = (scene.width, scene.height);
    let mut partners = Vec::new();
    for reach in REACHES {
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
            (seen.len() >= LEAST_FRAMES).then(|| std::array::from_fn(|c| median(seen.iter().map(|s| s[c]))))
        })
        .collect()
}

fn median(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: Vec<f32> = values.collect();
    m4_core::quantile(&mut values, 0.5).unwrap_or(0.0)
}

/// Evidence of motion a pixel, above 0 for moving, and its weight.
fn evidence(scene: &Scene<'_>, i: usize, before: &[u8]) -> (Vec<f32>, Vec<f32>) {
    let (w, h) = (scene.width, scene.height);
    let zone = dilated(&scene.near[i], w, h, MARGIN_PX);
    let background = background_colours(scene, i, &zone);
    let frame = &scene.shots[i].frame;
    // Shadows keep the pattern of what they fall on: the background may be darker by one factor around a pixel.
    let level = |rgb: [f32; 3]| rgb[0] + rgb[1] + rgb[2];
    let mut here: Vec<f32> = (0..w * h)
        .map(|p| background[p].map_or(0.0, |_| level(frame.rgb[p].map(f32::from))))
        .collect();
    let mut there: Vec<f32> = (0..w * h).map(|p| background[p].map_or(0.0, level)).collect();
    box_blur(w, h, &mut here);
    box_blur(w, h, &mut there);
    let (mut value, mut weight) = (vec![0.0; w * h], vec![0.0; w * h]);
    for p in 0..w * h {
        let Some(still) = background[p] else { continue };
        let rgb = frame.rgb[p].map(f32::from);
        let gain = (here[p] / there[p].max(1.0)).clamp(LEAST_GAIN, 1.0);
        let off = |g: f32| (0..3).map(|c| (rgb[c] - g * still[c]).abs()).fold(0.0, f32::max);
        let difference = off(1.0).min(off(gain) + GAIN_COST * (1.0 - gain));
        // Clamped, so that the mean around a pixel crosses 1 at an edge however strong the edge is.
        let step = if before[p] > 0 { STEP } else { STEP_OUTSIDE };
        value[p] = (difference / step).min(2.0);
        weight[p] = 1.0;
    }
    let mut total = weight.clone();
    box_blur(w, h, &mut value);
    box_blur(w, h, &mut total);
    for p in 0..w * h {
        if weight[p] > 0.0 {
            value[p] = (value[p] / total[p].max(1e-6) - 1.0).clamp(-1.0, 1.0);
        }
    }
    (value, weight)
}

/// The mask of a frame, from `before` (its mask so far) and the background.
pub(super) fn sharpen(scene: &Scene<'_>, i: usize, before: &[u8], smoother: &Smoother) -> Vec<u8> {
    let (mut value, mut weight) = evidence(scene, i, before);
    for p in 0..value.len() {
        let prior = if before[p] > 0 { PRIOR } else { -PRIOR };
        value[p] = value[p] * weight[p] + prior;
        weight[p] += PRIOR;
        value[p] /= weight[p];
    }
    let smooth = smoother.fill(&value, &weight, SMOOTH_LAMBDA).0;
    super::motion::mask(scene.width, scene.height, &smooth)
}

#[cfg(test)]
mod tests {
    use super::super::shot::Shot;
    use super::super::smooth::Smoother;
    use super::super::sweep::Range;
    use super::super::working::WorkingFrame;
    use super::{Scene, dilated, sharpen};
    use m4_core::{
        Camera, Intrinsics, Se3,
        nalgebra::{Vector3, Vector6},
    };

    const W: usize = 96;
    const H: usize = 72;
    const FRAMES: usize = 24;

    fn pattern(x: f64, y: f64) -> u8 {
        let wave = |k: f64, a: f64| ((x * a.cos() + y * a.sin()) * k).sin();
        (120.0 + 30.0 * wave(9.0, 0.3) + 25.0 * wave(23.0, 1.9) + 20.0 * wave(41.0, 2.7)) as u8
    }

    fn camera(t: usize) -> Camera {
        Camera {
            intrinsics: Intrinsics::centred(W, H, 80.0),
            c2w: Se3::identity().retract(&Vector6::new(0.04 * t as f64, 0.0, 0.0, 0.0, 0.0, 0.0)),
        }
    }

    /// A square in front of a wall at depth 4, which it darkens on the left of itself.
    fn inside(t: usize, x: usize, y: usize) -> bool {
        let left = 20 + 2 * t;
        (left..left + 16).contains(&x) && (25..45).contains(&y)
    }

    fn share(a: &[u8], b: &[u8]) -> f64 {
        let both = a.iter().zip(b).filter(|(a, b)| **a > 0 && **b > 0).count();
        let any = a.iter().zip(b).filter(|(a, b)| **a > 0 || **b > 0).count();
        both as f64 / any as f64
    }

    #[test]
    fn wide_mask_shrinks_to_the_object_without_its_shadow() {
        let cameras: Vec<Camera> = (0..FRAMES).map(camera).collect();
        let truth: Vec<Vec<u8>> = (0..FRAMES)
            .map(|t| {
                (0..W * H)
                    .map(|p| if inside(t, p % W, p / W) { 255 } else { 0 })
                    .collect()
            })
            .collect();
        let shots: Vec<Shot> = (0..FRAMES)
            .map(|t| {
                let rgb: Vec<[u8; 3]> = (0..W * H)
                    .map(|p| {
                        let (x, y) = (p % W, p / W);
                        if inside(t, x, y) {
                            return [230, 200 - 6 * (x % 4) as u8, 40];
                        }
                        let at: Vector3<f64> = cameras[t].unproject(x as f64, y as f64, 4.0);
                        let shadow = x < W - 6 && inside(t, x + 6, y);
                        let v = pattern(at.x, at.y);
                        [if shadow { (f32::from(v) * 0.7) as u8 } else { v }; 3]
                    })
                    .collect();
                Shot {
                    frame: WorkingFrame {
                        width: W,
                        height: H,
                        grey: rgb.iter().map(|c| f32::from(c[0])).collect(),
                        rgb,
                        camera: cameras[t],
                    },
                    census: Vec::new(),
                    points: Vec::new(),
                    partners: Vec::new(),
                    range: Range {
                        least: 0.1,
                        step: 0.1,
                        count: 8,
                    },
                }
            })
            .collect();
        let before: Vec<Vec<u8>> = truth.iter().map(|m| dilated(m, W, H, 4)).collect();
        let near: Vec<Vec<u8>> = before.iter().map(|m| dilated(m, W, H, 2)).collect();
        let background = vec![vec![0.25f32; W * H]; FRAMES];
        let scene = Scene {
            width: W,
            height: H,
            cameras: &cameras,
            shots: &shots,
            background: &background,
            near: &near,
        };
        let t = FRAMES / 2;
        let smoother = Smoother::new(W, H, &shots[t].frame.rgb, 8.0);
        let after = sharpen(&scene, t, &before[t], &smoother);
        let (wide, sharp) = (share(&before[t], &truth[t]), share(&after, &truth[t]));
        assert!(wide < 0.55 && sharp > 0.75, "{wide} {sharp}");
    }
}
