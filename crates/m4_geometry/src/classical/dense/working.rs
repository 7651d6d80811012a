//! Frames at the working size.

use super::flow::FlowImage;
use crate::resample::rgb_and_grey;
use m4_core::{Camera, RgbImage};

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
