//! Images of any size as the network takes them, the places of its maps' pixels, and its maps in
//! the images' size.

use super::focal;
use crate::NetError;
use crate::dinov2::PATCH;
use crate::error::refuse;
use crate::ops::{Kernels, bilinear, image_tensor};
use burn_core::tensor::{DType, Device, Tensor, TensorData};
use m4_core::{Plane, RgbImage};
use rayon::prelude::*;

/// The most patches that an image may be cut into; the published networks were trained with up to
/// 3600.
pub const MOST_TOKENS: usize = 20_000;

/// An image's sides, and the patches that it is cut into.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    pub width: usize,
    pub height: usize,
    /// Patches across and down.
    pub across: usize,
    pub down: usize,
}

impl Grid {
    /// Of an image of `width` by `height` in about `tokens` patches, one at least each way.
    pub fn of((width, height): (usize, usize), tokens: usize) -> Result<Self, NetError> {
        if width == 0 || height == 0 {
            return refuse("depth needs an image with pixels");
        }
        if !(1..=MOST_TOKENS).contains(&tokens) {
            return refuse(format!(
                "an image can be cut into 1 to {MOST_TOKENS} patches, not {tokens}"
            ));
        }
        let aspect = width as f64 / height as f64;
        let side = |squared: f64| (squared.sqrt().round_ties_even() as usize).clamp(1, tokens);
        Ok(Self {
            width,
            height,
            across: side(tokens as f64 * aspect),
            down: side(tokens as f64 / aspect),
        })
    }

    /// The image `[1, 3, 14 down, 14 across]` from 0 to 1.
    pub fn tensor(self, image: &RgbImage, device: &Device) -> Tensor<4> {
        let size = (self.across * PATCH, self.down * PATCH);
        image_tensor(image, size, Kernels::triangle, [[0.0; 3], [1.0; 3]], device)
    }

    /// Where the pixels of level `level` (of `2^level` times as many as there are patches each way)
    /// are, `[1, 2, h, w]`: to the right and down from the image's middle, in units of half its
    /// diagonal.
    pub fn places(self, level: usize, device: &Device, dtype: DType) -> Tensor<4> {
        let (w, h) = (self.across << level, self.down << level);
        let diagonal = (self.width as f64).hypot(self.height as f64);
        let place = |i: usize, n: usize, side: usize| {
            let from_middle = (2.0 * i as f64 + 1.0 - n as f64) / n as f64;
            (from_middle * side as f64 / diagonal) as f32
        };
        let x = (0..h * w).map(|i| place(i % w, w, self.width));
        let y = (0..h * w).map(|i| place(i / w, h, self.height));
        let values: Vec<f32> = x.chain(y).collect();
        Tensor::from_data(TensorData::new(values, [1, 2, h, w]), (device, dtype))
    }

    /// Planes `[n][h][w]` of a map in the image's size, bilinear.
    pub fn to_image(self, planes: &[f32], w: usize, h: usize) -> Vec<f32> {
        bilinear(planes, (w, h), (self.width, self.height))
    }
}

/// How to look at an image.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MoGeOptions {
    /// Patches that the image is cut into, about; `None` for the most that the network was trained
    /// with. Fewer are faster and coarser.
    pub tokens: Option<usize>,
    /// The focal length of the image, pixels, where it is known. Else it is found with the depth.
    pub known_focal_px: Option<f64>,
}

/// An image's geometry. OpenCV axes: x right, y down, z forward.
#[derive(Debug, Clone, PartialEq)]
pub struct MoGeMap {
    /// z-depth, metres, `[height][width]` as the image; 0 where `mask` is false.
    pub depth_m: Plane<f32>,
    /// Where there is depth: not in the sky, and not where the network is in doubt.
    pub mask: Plane<bool>,
    /// Focal length, pixels, the same in both directions; the principal point is the image's
    /// middle.
    pub focal_px: f64,
    /// Horizontal field of view, radians.
    pub fov_x_rad: f64,
}

/// What the network says of an image of `width` by `height` pixels.
#[derive(Debug, Clone)]
pub struct RawOutput {
    pub width: usize,
    pub height: usize,
    /// `[height][width]`, right up to a scale and an offset of their depth.
    pub points: Vec<[f32; 3]>,
    /// `[height][width]`: how likely there is depth.
    pub mask: Vec<f32>,
    pub metric_scale: f32,
}

/// Depth counts where the network thinks it likelier than not.
const LIKELY: f32 = 0.5;

impl RawOutput {
    /// Of planes `[n][height][width]` of raw numbers: three for points, one for the mask (a logit).
    pub fn of_planes(
        (width, height): (usize, usize),
        points: &[f32],
        mask: &[f32],
        metric_scale: f32,
    ) -> Self {
        let n = points.len() / 3;
        let point = |i: usize| {
            let z = points[2 * n + i].exp();
            [points[i] * z, points[n + i] * z, z]
        };
        Self {
            width,
            height,
            points: (0..n).into_par_iter().map(point).collect(),
            mask: mask.iter().map(|x| 1.0 / (1.0 + (-x).exp())).collect(),
            metric_scale,
        }
    }

    /// The image's geometry, its focal length `known_focal_px` if there is one.
    pub fn geometry(self, known_focal_px: Option<f64>) -> Result<MoGeMap, NetError> {
        let (width, height) = (self.width, self.height);
        if let Some(focal) = known_focal_px.filter(|f| !(f.is_finite() && *f > 0.0)) {
            return refuse(format!(
                "a focal length is a positive number of pixels, not {focal}"
            ));
        }
        let scale = self.metric_scale;
        if !(scale.is_finite() && scale > 0.0) {
            return Err(NetError::Device(format!(
                "the network says that a unit is {scale} metres"
            )));
        }
        let half_diagonal = (width as f64).hypot(height as f64) / 2.0;
        let likely = |i: usize| self.mask.get(i).is_some_and(|&m| m > LIKELY);
        let known_focal = known_focal_px.map(|f| f / half_diagonal);
        let solution = focal::recovered(&self.points, likely, (width, height), known_focal)?;
        let shift = solution.shift as f32;
        let depth = |i: usize| {
            let z = (self.points[i][2] + shift) * scale;
            if likely(i) && z > 0.0 && z.is_finite() {
                z
            } else {
                0.0
            }
        };
        let depth_m = Plane::from_fn(width, height, |x, y| depth(y * width + x));
        let mask = depth_m.map(|&z| z > 0.0);
        let focal_px = known_focal_px.unwrap_or(solution.focal * half_diagonal);
        Ok(MoGeMap {
            depth_m,
            mask,
            focal_px,
            fov_x_rad: 2.0 * (width as f64 / (2.0 * focal_px)).atan(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{Grid, MOST_TOKENS};
    use crate::cpu;
    use burn_core::tensor::DType;

    #[test]
    fn patches_have_the_aspect_of_the_image() {
        let grid = |w, h, tokens| {
            let grid = Grid::of((w, h), tokens).unwrap();
            (grid.across, grid.down)
        };
        assert_eq!(grid(854, 480, 1800), (57, 32));
        assert_eq!(grid(180, 140, 80), (10, 8));
        assert_eq!(grid(1_000_000, 1, 1200), (1200, 1));
        assert_eq!(grid(1, 1, 1), (1, 1));
        assert!(Grid::of((5, 0), 1200).is_err());
        assert!(Grid::of((5, 5), 0).is_err() && Grid::of((5, 5), MOST_TOKENS + 1).is_err());
    }

    #[test]
    fn places_are_symmetric_and_end_within_the_image() {
        let grid = Grid::of((300, 400), 12).unwrap();
        let places: Vec<f32> = grid
            .places(1, &cpu(), DType::F32)
            .try_into_vec_as()
            .unwrap();
        let (w, h) = (2 * grid.across, 2 * grid.down);
        assert_eq!((w, h, places.len()), (6, 8, 96));
        // half a pixel of 300 / 6 from the left edge, which is 300 / 500 from the middle
        assert!((places[0] + 0.6 * 5.0 / 6.0).abs() < 1e-6 && (places[5] - 0.5).abs() < 1e-6);
        assert!(
            (places[48] + 0.8 * 7.0 / 8.0).abs() < 1e-6,
            "{}",
            places[48]
        );
    }
}
