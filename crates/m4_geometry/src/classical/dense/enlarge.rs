//! From the working size to the size of the frames, along the edges of the frames.

use super::estimate::DenseFrame;
use m4_core::{Plane, RgbImage};

/// Colour difference at which a neighbour counts half, 0..255.
const COLOUR: f32 = 8.0;
/// Disparities that differ by less than this share are of one surface and may be averaged.
const SAME_SURFACE: f32 = 0.03;

/// What the working size knows of one frame; planes are `[height][width]`.
pub(super) struct Small<'a> {
    /// Columns and rows.
    pub size: (usize, usize),
    /// Colours, 0..255.
    pub rgb: &'a [[u8; 3]],
    pub disparity: &'a [f32],
    pub moving: &'a [u8],
    pub confidence: &'a [f32],
}

/// The weight of each of the 3x3 pixels around a position; 0 outside the image.
struct Neighbours {
    index: [usize; 9],
    weight: [f32; 9],
}

/// Every pixel takes mask and depth from those of the nine nearest small pixels that resemble it in
/// colour. Depth is averaged over one surface only, so that nothing floats between two.
pub(super) fn enlarge(image: &RgbImage, small: &Small<'_>) -> DenseFrame {
    let (width, height) = image.size();
    let (sx, sy) = (small.size.0 as f32 / width as f32, small.size.1 as f32 / height as f32);
    let mut depth = Plane::filled(width, height, 1.0f32);
    let mut mask = Plane::filled(width, height, 0u8);
    let mut confidence = Plane::filled(width, height, 0.0f32);
    for y in 0..height {
        for x in 0..width {
            let at = ((x as f32 + 0.5) * sx - 0.5, (y as f32 + 0.5) * sy - 0.5);
            let near = neighbours(small, at, image[(x, y)]);
            let (mut moves, mut total) = (0.0, 0.0);
            for (&i, &w) in near.index.iter().zip(&near.weight) {
                total += w;
                moves += if small.moving[i] > 0 { w } else { 0.0 };
            }
            let moving = moves > 0.5 * total;
            let fits = |i: usize| (small.moving[i] > 0) == moving;
            let (mut best, mut most) = (near.index[4], 0.0f32);
            for (&i, &w) in near.index.iter().zip(&near.weight) {
                if fits(i) && w > most {
                    (best, most) = (i, w);
                }
            }
            let surface = small.disparity[best];
            let (mut sum, mut sure, mut weight) = (0.0, 0.0, 0.0);
            for (&i, &w) in near.index.iter().zip(&near.weight) {
                if fits(i) && (small.disparity[i] - surface).abs() <= SAME_SURFACE * surface {
                    sum += w * small.disparity[i];
                    sure += w * small.confidence[i];
                    weight += w;
                }
            }
            depth[(x, y)] = if weight > 0.0 { weight / sum } else { 1.0 / surface };
            mask[(x, y)] = if moving { 255 } else { 0 };
            confidence[(x, y)] = if moving || weight == 0.0 {
                0.0
            } else {
                (sure / weight).min(1.0)
            };
        }
    }
    DenseFrame {
        depth,
        mask,
        confidence,
    }
}

fn neighbours(small: &Small<'_>, (x, y): (f32, f32), colour: [u8; 3]) -> Neighbours {
    let (w, h) = (small.size.0 as isize, small.size.1 as isize);
    let clamp = |v: f32, n: isize| (v.round() as isize).clamp(0, n - 1);
    let (cx, cy) = (clamp(x, w), clamp(y, h));
    let mut out = Neighbours {
        index: [0; 9],
        weight: [0.0; 9],
    };
    for k in 0..9 {
        let (nx, ny) = (cx + k as isize % 3 - 1, cy + k as isize / 3 - 1);
        let inside = nx >= 0 && ny >= 0 && nx < w && ny < h;
        let i = (ny.clamp(0, h - 1) * w + nx.clamp(0, w - 1)) as usize;
        out.index[k] = i;
        if inside {
            // A tent two pixels wide, never 0, times the likeness of the colours.
            let (dx, dy) = (x - nx as f32, y - ny as f32);
            let space = (1.6 - dx.abs()).max(0.05) * (1.6 - dy.abs()).max(0.05);
            let differences = small.rgb[i].iter().zip(&colour).map(|(a, b)| a.abs_diff(*b));
            let difference = f32::from(differences.fold(0, u8::max));
            out.weight[k] = space / (1.0 + (difference / COLOUR).powi(2));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::{Small, enlarge};
    use crate::resample::rgb_and_grey;
    use m4_core::Plane;

    #[test]
    fn an_edge_is_found_again_and_nothing_floats() {
        // The edge lies at full-size column 22, inside small pixel 5 of 16 (columns 20 to 23).
        let image = Plane::from_fn(64, 48, |x, _| if x < 22 { [30; 3] } else { [200; 3] });
        let (rgb, _) = rgb_and_grey(&image, 16, 12);
        let disparity: Vec<f32> = (0..16 * 12).map(|i| if i % 16 < 5 { 0.25 } else { 1.0 }).collect();
        let moving: Vec<u8> = (0..16 * 12).map(|i| if i % 16 < 5 { 0 } else { 255 }).collect();
        let confidence = vec![1.0; 16 * 12];
        let small = Small {
            size: (16, 12),
            rgb: &rgb,
            disparity: &disparity,
            moving: &moving,
            confidence: &confidence,
        };
        let out = enlarge(&image, &small);
        for x in 0..64 {
            let (z, m) = (out.depth[(x, 20)], out.mask[(x, 20)]);
            assert!((z - 4.0).abs() < 1e-3 || (z - 1.0).abs() < 1e-3, "column {x}: {z}");
            let near = x >= 22;
            assert_eq!((z < 2.0, m > 0), (near, near), "column {x}");
        }
    }
}
