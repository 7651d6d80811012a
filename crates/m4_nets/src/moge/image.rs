//! Images of any size as the network takes them, the places of its maps' pixels, and its maps in the images' size.

use super::layout::Remap;
use super::{MoGeError, focal};
use crate::dinov2::PATCH;
use crate::ops::{Kernels, planes, resampled, tensor};
use burn_core::tensor::{DType, Device, Tensor, TensorData};
use m4_core::{Plane, RgbImage};
use rayon::prelude::*;

/// The most patches that an image may be cut into; the published networks were trained with up to 3600.
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
    ///
    /// # Errors
    ///
    /// [`MoGeError::Empty`] if it has no pixels, [`MoGeError::Tokens`] if there are to be no patches or too many.
    pub fn of(width: usize, height: usize, tokens: usize) -> Result<Self, MoGeError> {
        if width == 0 || height == 0 {
            return Err(MoGeError::Empty);
        }
        if !(1..=MOST_TOKENS).contains(&tokens) {
            return Err(MoGeError::Tokens(tokens));
        }
        let aspect = width as f64 / height as f64;
        let side = |squared: f64| (squared.sqrt().round_ties_even() as usize).clamp(1, tokens);
        Ok(Self { width, height, across: side(tokens as f64 * aspect), down: side(tokens as f64 / aspect) })
    }

    /// The image `[1, 3, 14 down, 14 across]` from 0 to 1.
    pub fn tensor(self, image: &RgbImage, device: &Device) -> Tensor<4> {
        let (width, height) = (self.across * PATCH, self.down * PATCH);
        let values = planes(image, [0.0; 3], [1.0; 3]);
        let columns = Kernels::triangle(self.width, width);
        let rows = Kernels::triangle(self.height, height);
        let values = resampled(&values, self.width, self.height, &columns, &rows);
        tensor(values, [1, 3, height, width], device)
    }

    /// Where the pixels of level `level` (of `2^level` times as many as there are patches each way) are, `[1, 2, h, w]`: to the right and
    /// down from the image's middle, in units of half its diagonal.
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
        resampled(planes, w, h, &Kernels::linear(w, self.width), &Kernels::linear(h, self.height))
    }
}

/// How to look at an image.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MoGeOptions {
    /// Patches that the image is cut into, about; `None` for the most that the network was trained with
    /// ([`MoGe::tokens`](super::MoGe::tokens)). Fewer are faster and coarser.
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
    /// Directions that surfaces face, of length 1; 0 where `mask` is false. `None` if the checkpoint has no head for them.
    pub normal: Option<Plane<[f32; 3]>>,
    /// Focal length, pixels, the same in both directions; the principal point is the image's middle.
    pub focal_px: f64,
    /// Horizontal field of view, radians.
    pub fov_x_rad: f64,
    /// Metres in a unit of the network's own points, which `depth_m` contains already.
    pub metric_scale: f32,
}

impl MoGeMap {
    /// The points of the pixels, metres, `[height][width]` of `[x, y, z]`; 0 where `mask` is false.
    #[must_use]
    pub fn points_m(&self) -> Plane<[f32; 3]> {
        let (w, h) = self.depth_m.size();
        Plane::from_fn(w, h, |x, y| {
            let z = self.depth_m[(x, y)];
            let side = |x: usize, w: usize| ((x as f64 + 0.5 - w as f64 / 2.0) / self.focal_px) as f32 * z;
            [side(x, w), side(y, h), z]
        })
    }
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
    /// `[height][width]`, of any length.
    pub normal: Option<Vec<[f32; 3]>>,
    pub metric_scale: f32,
}

/// Depth counts where the network thinks it likelier than not.
const LIKELY: f32 = 0.5;

impl RawOutput {
    /// Points and masks out of planes `[n][height][width]` of raw numbers: three for points, one for the mask (a logit), three for
    /// normals.
    pub fn of_planes(
        (width, height): (usize, usize),
        points: &[f32],
        mask: &[f32],
        normal: Option<&[f32]>,
        remap: Remap,
        metric_scale: f32,
    ) -> Self {
        Self {
            width,
            height,
            points: interleaved(points, |p| remap.point(p)),
            mask: mask.iter().map(|x| 1.0 / (1.0 + (-x).exp())).collect(),
            normal: normal.map(|normal| interleaved(normal, |n| n)),
            metric_scale,
        }
    }

    /// The image's geometry, its focal length `known_focal_px` if there is one.
    ///
    /// # Errors
    ///
    /// [`MoGeError`] if the focal length is not a length, nothing is valid, or nothing explains the points.
    pub fn geometry(self, known_focal_px: Option<f64>) -> Result<MoGeMap, MoGeError> {
        let (width, height) = (self.width, self.height);
        if let Some(focal) = known_focal_px.filter(|f| !(f.is_finite() && *f > 0.0)) {
            return Err(MoGeError::FocalLength(focal));
        }
        let scale = self.metric_scale;
        if !(scale.is_finite() && scale > 0.0) {
            return Err(MoGeError::Scale(scale));
        }
        let half_diagonal = (width as f64).hypot(height as f64) / 2.0;
        let likely = |i: usize| self.mask.get(i).is_some_and(|&m| m > LIKELY);
        let known = known_focal_px.map(|f| f / half_diagonal);
        let found = focal::recovered(&self.points, likely, (width, height), known)?;
        let shift = found.shift as f32;
        let depth = |i: usize| {
            let z = (self.points[i][2] + shift) * scale;
            if likely(i) && z > 0.0 && z.is_finite() { z } else { 0.0 }
        };
        let depth_m = Plane::from_fn(width, height, |x, y| depth(y * width + x));
        let mask = depth_m.map(|&z| z > 0.0);
        let facing = |i: usize, n: [f32; 3]| {
            let length = n.iter().map(|x| x * x).sum::<f32>().sqrt().max(1e-12);
            if mask.data()[i] { n.map(|x| x / length) } else { [0.0; 3] }
        };
        let normal = self
            .normal
            .as_ref()
            .map(|normal| Plane::from_fn(width, height, |x, y| facing(y * width + x, normal[y * width + x])));
        let focal_px = known_focal_px.unwrap_or(found.focal * half_diagonal);
        Ok(MoGeMap {
            depth_m,
            mask,
            normal,
            focal_px,
            fov_x_rad: 2.0 * (width as f64 / (2.0 * focal_px)).atan(),
            metric_scale: scale,
        })
    }
}

/// Planes `[3][n]` as `n` triples, each through `f`.
fn interleaved(planes: &[f32], f: impl Fn([f32; 3]) -> [f32; 3] + Sync) -> Vec<[f32; 3]> {
    let n = planes.len() / 3;
    (0..n).into_par_iter().map(|i| f([planes[i], planes[n + i], planes[2 * n + i]])).collect()
}

#[cfg(test)]
mod tests {
    use super::{Grid, MOST_TOKENS};
    use crate::cpu;
    use burn_core::tensor::DType;

    #[test]
    fn patches_have_the_aspect_of_the_image() {
        let grid = |w, h, tokens| {
            let grid = Grid::of(w, h, tokens).unwrap();
            (grid.across, grid.down)
        };
        assert_eq!(grid(854, 480, 1800), (57, 32));
        assert_eq!(grid(180, 140, 80), (10, 8));
        assert_eq!(grid(1_000_000, 1, 1200), (1200, 1));
        assert_eq!(grid(1, 1, 1), (1, 1));
        assert!(Grid::of(5, 0, 1200).is_err());
        assert!(Grid::of(5, 5, 0).is_err() && Grid::of(5, 5, MOST_TOKENS + 1).is_err());
    }

    #[test]
    fn places_are_symmetric_and_end_within_the_image() {
        let grid = Grid::of(300, 400, 12).unwrap();
        let places: Vec<f32> = grid.places(1, &cpu(), DType::F32).try_into_vec_as().unwrap();
        let (w, h) = (2 * grid.across, 2 * grid.down);
        assert_eq!((w, h, places.len()), (6, 8, 96));
        // half a pixel of 300 / 6 from the left edge, which is 300 / 500 from the middle
        assert!((places[0] + 0.6 * 5.0 / 6.0).abs() < 1e-6 && (places[5] - 0.5).abs() < 1e-6);
        assert!((places[48] + 0.8 * 7.0 / 8.0).abs() < 1e-6, "{}", places[48]);
    }
}
