//! A pinhole camera at one pose.

use crate::{Se3, nalgebra::Vector3};

/// Pinhole intrinsics in pixels, without distortion.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Intrinsics {
    /// Columns of the image.
    pub width: usize,
    /// Rows of the image.
    pub height: usize,
    /// Horizontal focal length, pixels.
    pub fx: f64,
    /// Vertical focal length, pixels.
    pub fy: f64,
    /// Principal point from the image's left edge, pixels (centre of the first pixel: 0.5).
    pub cx: f64,
    /// Principal point from the image's top edge, pixels.
    pub cy: f64,
}

impl Intrinsics {
    /// Square pixels, principal point in the middle.
    pub fn centred(width: usize, height: usize, focal_px: f64) -> Self {
        Self {
            width,
            height,
            fx: focal_px,
            fy: focal_px,
            cx: width as f64 / 2.0,
            cy: height as f64 / 2.0,
        }
    }

    /// The same field of view on an image of another size.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (sx, sy) = (
            width as f64 / self.width as f64,
            height as f64 / self.height as f64,
        );
        Self {
            width,
            height,
            fx: self.fx * sx,
            fy: self.fy * sy,
            cx: self.cx * sx,
            cy: self.cy * sy,
        }
    }

    /// Horizontal field of view, radians.
    pub fn horizontal_fov_rad(&self) -> f64 {
        2.0 * (self.width as f64 / (2.0 * self.fx)).atan()
    }
}

/// A pinhole camera somewhere in the world.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Camera {
    /// Lens and image size.
    pub intrinsics: Intrinsics,
    /// Camera to world, OpenCV axes.
    pub c2w: Se3<f64>,
}

impl Camera {
    /// World to camera.
    pub fn w2c(&self) -> Se3<f64> {
        self.c2w.inverse()
    }

    /// The camera's centre in the world.
    pub fn centre(&self) -> Vector3<f64> {
        self.c2w.translation
    }

    /// Pixel coordinates (centre of the first pixel: 0, 0) and z-depth of a world point; the pixel
    /// means nothing where the depth is not above 0.
    pub fn project(&self, world: &Vector3<f64>) -> ([f64; 2], f64) {
        let k = &self.intrinsics;
        let p = self.w2c().transform(world);
        (
            [k.fx * p.x / p.z + k.cx - 0.5, k.fy * p.y / p.z + k.cy - 0.5],
            p.z,
        )
    }

    /// The world point at pixel coordinates `(u, v)` (centre of the first pixel: 0, 0) and z-depth
    /// `z` (Minute4D Eq. 4).
    pub fn unproject(&self, u: f64, v: f64, z: f64) -> Vector3<f64> {
        let k = &self.intrinsics;
        let p = Vector3::new((u + 0.5 - k.cx) / k.fx * z, (v + 0.5 - k.cy) / k.fy * z, z);
        self.c2w.transform(&p)
    }

    /// The same camera with an image of another size.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        Self {
            intrinsics: self.intrinsics.resized(width, height),
            c2w: self.c2w,
        }
    }
}
