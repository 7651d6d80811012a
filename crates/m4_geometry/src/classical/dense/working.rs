//! Frames at the working size.

use super::flow::FlowImage;
use m4_core::{Camera, Plane, RgbImage};

/// One frame at the working size.
#[derive(Debug, Clone)]
pub(super) struct WorkingFrame {
    pub width: usize,
    pub height: usize,
    /// `[height][width][3]`, 0..255.
    pub rgb: Vec<[u8; 3]>,
    /// `[height][width]`, 0..255.
    pub grey: Vec<f32>,
    /// The frame's camera for this size.
    pub camera: Camera,
}

/// The size whose longest side is `side`, or the size itself if it is smaller.
pub(crate) fn working_size(width: usize, height: usize, side: usize) -> (usize, usize) {
    let longest = width.max(height);
    if longest <= side {
        return (width, height);
    }
    let scaled = |n: usize| ((n * side + longest / 2) / longest).max(1);
    (scaled(width), scaled(height))
}

/// What a pixel of the working size takes in a frame while the clip is worked on, bytes: 81 were measured with the
/// planes of this module (docs/geometry.md), rounded up.
const BYTES_PER_PIXEL: usize = 85;
/// Sides below this show too little to work on.
const LEAST_SIDE: usize = 160;

/// The longest side, at most `side`, at which `frames` frames of `width` x `height` stay within `memory_mb` megabytes; not less than
/// 160 pixels.
pub(super) fn fitting_side(width: usize, height: usize, side: usize, frames: usize, memory_mb: usize) -> usize {
    let (w, h) = working_size(width, height, side);
    let wanted = (w * h * frames.max(1) * BYTES_PER_PIXEL) as f64;
    let share = (memory_mb as f64 * 1e6 / wanted).min(1.0).sqrt();
    ((w.max(h) as f64 * share) as usize).max(LEAST_SIDE).min(side)
}

impl WorkingFrame {
    pub fn new(image: &RgbImage, camera: &Camera, width: usize, height: usize) -> Self {
        let (rgb, grey) = rgb_and_grey(image, width, height);
        Self {
            width,
            height,
            rgb,
            grey,
            camera: camera.resized(width, height),
        }
    }

    pub fn flow_image(&self) -> FlowImage<'_> {
        FlowImage {
            width: self.width,
            height: self.height,
            rgb: &self.rgb,
            grey: &self.grey,
        }
    }
}

/// What share of source sample `i` lies in target cell `cell` of `n` source samples shared by `m` cells.
fn overlap(cell: usize, n: usize, m: usize) -> Vec<(usize, f32)> {
    let (start, end) = (
        cell as f64 * n as f64 / m as f64,
        (cell + 1) as f64 * n as f64 / m as f64,
    );
    (start as usize..(end.ceil() as usize).min(n))
        .map(|i| {
            let share = (end.min((i + 1) as f64) - start.max(i as f64)).max(0.0);
            (i, (share / (end - start)) as f32)
        })
        .collect()
}

/// The image at another size, not larger, and its luma 0..255, not rounded.
pub(crate) fn rgb_and_grey(image: &RgbImage, width: usize, height: usize) -> (Vec<[u8; 3]>, Vec<f32>) {
    let exact = shrink(image, width, height);
    let luma = |c: &[f32; 3]| 0.299 * c[0] + 0.587 * c[1] + 0.114 * c[2];
    let grey = exact.iter().map(luma).collect();
    (exact.iter().map(|c| c.map(|v| v.round() as u8)).collect(), grey)
}

/// The mean of the pixels of each pixel of a smaller size.
pub(crate) fn shrunk(image: &RgbImage, width: usize, height: usize) -> RgbImage {
    let exact = shrink(image, width, height);
    Plane::from_fn(width, height, |x, y| exact[y * width + x].map(|v| v.round() as u8))
}

/// Area average; sizes must not grow.
fn shrink(image: &RgbImage, width: usize, height: usize) -> Vec<[f32; 3]> {
    let columns: Vec<_> = (0..width).map(|x| overlap(x, image.width(), width)).collect();
    let mut out = vec![[0.0f32; 3]; width * height];
    for y in 0..height {
        let target = &mut out[y * width..(y + 1) * width];
        for (sy, wy) in overlap(y, image.height(), height) {
            let row = image.row(sy);
            for (t, column) in target.iter_mut().zip(&columns) {
                for &(sx, wx) in column {
                    for (t, &v) in t.iter_mut().zip(&row[sx]) {
                        *t += wy * wx * f32::from(v);
                    }
                }
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::fitting_side;

    #[test]
    fn long_clips_are_worked_on_at_a_smaller_size() {
        assert_eq!(fitting_side(1920, 1080, 480, 96, 4096), 480);
        let long = fitting_side(1920, 1080, 480, 1500, 4096);
        assert!((160..300).contains(&long), "{long}");
        let bytes = long * (long * 1080 / 1920) * 1500 * super::BYTES_PER_PIXEL;
        assert!(bytes <= 4_100_000_000, "{bytes}");
        assert_eq!(fitting_side(1920, 1080, 480, 1_000_000, 4096), 160);
    }
}
