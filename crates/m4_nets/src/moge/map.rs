//! Converts the network's output to depth in metres.

use super::config::Remap;
use super::{MoGeError, focal};
use m4_core::Plane;
use rayon::prelude::*;

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
