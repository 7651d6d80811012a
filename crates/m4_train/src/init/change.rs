//! Changes of brightness without motion: shadows, reflections, lamps.
//!
//! A mask knows things that move; their shadows fall on things that do not. A pixel of static
//! surface is compared with the mean colour of its voxel over all frames; where a whole patch of
//! the frame is darker or brighter than that mean, thin dark or bright splats are laid over the
//! surface for the time of the frame. They tint the surface instead of repainting it, so few
//! suffice.

use crate::init::{
    InitConfig,
    cloud::{Cloud, visit_static_pixels},
    voxel::{Centroids, Grid},
};
use m4_core::CaptureFrame;

/// Every n-th pixel and row is compared.
const STEP: usize = 2;
/// Half the side of the patch that is averaged, compared pixels: texture cancels, shadows do not.
const PATCH: usize = 3;
/// At most this share of a frame counts as changed (our rule).
const MOST_CHANGED: f32 = 0.1;
/// Overlays float this share of the depth in front of the surface: near enough to show no parallax.
const LIFT: f64 = 0.01;

/// Patches of one frame; the colour of each point is the share of light taken away or added,
/// 0..255.
#[derive(Debug, Clone, Default)]
pub(crate) struct Changes {
    /// Where less light arrives than on average.
    pub darker: Cloud,
    /// Patches that are brighter.
    pub brighter: Cloud,
}

/// Compares a frame with the mean colours of `voxels`, which `grid` made.
pub(crate) fn changes(
    frame: &CaptureFrame,
    config: &InitConfig,
    grid: &Grid,
    voxels: &Centroids,
) -> Changes {
    let mut out = Changes::default();
    let Some(depth) = &frame.depth else {
        return out;
    };
    let (w, h) = depth.size();
    let (gw, gh) = (w.div_ceil(STEP), h.div_ceil(STEP));
    let grey = |c: [f32; 3]| (c[0] + c[1] + c[2]) / 3.0;
    // difference and mean of each compared pixel; NaN where nothing is known
    let mut difference = vec![f32::NAN; gw * gh];
    let mut mean = vec![0.0f32; gw * gh];
    let mut points = vec![[0.0f64; 3]; gw * gh];
    visit_static_pixels(frame, config, STEP, &mut |x, y, p, rgb| {
        let at = [p.x as f32, p.y as f32, p.z as f32];
        if let Some(i) = voxels.find(grid, at) {
            let k = (y / STEP) * gw + x / STEP;
            mean[k] = grey(voxels.rgb[i]);
            difference[k] = grey(rgb.map(|c| f32::from(c) / 255.0)) - mean[k];
            points[k] = [p.x, p.y, p.z];
        }
    });
    // What the whole frame has in common is its exposure.
    let mut differences: Vec<f32> = difference
        .iter()
        .copied()
        .filter(|d| d.is_finite())
        .collect();
    let Some(common) = m4_core::median(&mut differences) else {
        return out;
    };

    let patches = patch_means(&difference, gw, gh);
    let mut sizes: Vec<f32> = patches
        .iter()
        .filter(|d| d.is_finite())
        .map(|d| (d - common).abs())
        .collect();
    let rank = ((sizes.len() as f32 * (1.0 - MOST_CHANGED)) as usize).min(sizes.len() - 1);
    let threshold = sizes
        .select_nth_unstable_by(rank, f32::total_cmp)
        .1
        .max(config.change_threshold);

    let centre = frame.camera.centre();
    for k in 0..gw * gh {
        let d = patches[k] - common;
        if !difference[k].is_finite() || d.abs() <= threshold {
            continue;
        }
        let share = if d < 0.0 {
            -d / mean[k].max(0.02)
        } else {
            d / (1.0 - mean[k]).max(0.02)
        };
        let lifted = [0, 1, 2].map(|a| (points[k][a] + LIFT * (centre[a] - points[k][a])) as f32);
        let to = if d < 0.0 {
            &mut out.darker
        } else {
            &mut out.brighter
        };
        to.xyz.push(lifted);
        to.rgb
            .push([(share.clamp(0.0, 1.0) * 255.0).round() as u8; 3]);
    }
    out
}

/// Mean of the known values in the square around each entry; NaN where the entry itself is not
/// known.
fn patch_means(values: &[f32], w: usize, h: usize) -> Vec<f32> {
    // summed-area tables of values and counts
    let mut sums = vec![(0.0f64, 0u32); (w + 1) * (h + 1)];
    for y in 0..h {
        let mut row = (0.0f64, 0u32);
        for x in 0..w {
            let v = values[y * w + x];
            if v.is_finite() {
                row = (row.0 + f64::from(v), row.1 + 1);
            }
            let above = sums[y * (w + 1) + x + 1];
            sums[(y + 1) * (w + 1) + x + 1] = (row.0 + above.0, row.1 + above.1);
        }
    }
    let corner = |x: usize, y: usize| sums[y * (w + 1) + x];
    (0..w * h)
        .map(|i| {
            if !values[i].is_finite() {
                return f32::NAN;
            }
            let (x, y) = (i % w, i / w);
            let (x0, y0) = (x.saturating_sub(PATCH), y.saturating_sub(PATCH));
            let (x1, y1) = ((x + PATCH + 1).min(w), (y + PATCH + 1).min(h));
            let [a, b, c, d] = [
                corner(x0, y0),
                corner(x1, y0),
                corner(x0, y1),
                corner(x1, y1),
            ];
            let count = (d.1 + a.1) - (b.1 + c.1);
            ((d.0 - b.0 - c.0 + a.0) / f64::from(count.max(1))) as f32
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::patch_means;

    #[test]
    fn a_patch_mean_skips_what_is_not_known() {
        let mut values = vec![2.0f32; 10 * 9];
        values[0] = f32::NAN;
        values[11] = 50.0;
        let got = patch_means(&values, 10, 9);
        assert!(got[0].is_nan());
        assert_eq!(got[89], 2.0);
        // around (1, 1): 5 x 5 cut off at the corner, one unknown
        let want = (2.0 * 23.0 + 50.0) / 24.0;
        assert!((got[11] - want).abs() < 1e-5, "{} for {want}", got[11]);
    }
}
