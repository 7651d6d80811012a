//! The camera as the network was trained with it: pixel centres are whole numbers, and an image of another size has the same corner
//! pixels.
//!
//! Intrinsics come with the principal point from the image's corner; half a pixel is taken off here, before they are scaled by
//! `(size - 1) / (old size - 1)` as upstream does. The world is moved so that a point near the cameras is its origin: 32 bits then
//! suffice wherever the scene lies.

use m4_core::{Camera, Se3, nalgebra::Vector3};

/// A camera over an image of the size that the network works with.
#[derive(Debug, Clone, Copy)]
pub struct PosedPinhole {
    focal: [f64; 2],
    centre: [f64; 2],
    c2w: Se3<f64>,
}

impl PosedPinhole {
    /// `camera` over an image of `size`, in a world whose origin is at `origin`; `None` if its numbers are none.
    pub fn new(camera: &Camera, size: (usize, usize), origin: &Vector3<f64>) -> Option<Self> {
        let k = &camera.intrinsics;
        let scale = |to: usize, from: usize| {
            if from > 1 { (to - 1) as f64 / (from - 1) as f64 } else { to as f64 }
        };
        let (sx, sy) = (scale(size.0, k.width), scale(size.1, k.height));
        let lens = Self {
            focal: [k.fx * sx, k.fy * sy],
            centre: [(k.cx - 0.5) * sx, (k.cy - 0.5) * sy],
            c2w: Se3 { rotation: camera.c2w.rotation, translation: camera.c2w.translation - origin },
        };
        let numbers = lens.c2w.rotation.iter().chain(lens.c2w.translation.iter());
        let finite = numbers.chain(&lens.focal).chain(&lens.centre).all(|x| x.is_finite());
        (finite && lens.focal.iter().all(|&f| f > 0.0)).then_some(lens)
    }

    /// The point at depth `z` behind a place in the image.
    pub fn unproject(&self, [u, v]: [f64; 2], z: f64) -> Vector3<f64> {
        let x = (u - self.centre[0]) / self.focal[0] * z;
        let y = (v - self.centre[1]) / self.focal[1] * z;
        self.c2w.transform(&Vector3::new(x, y, z))
    }

    /// The point at depth 1 behind a place in the image, in the camera's axes.
    pub fn ray(&self, [u, v]: [f64; 2]) -> [f64; 3] {
        [(u - self.centre[0]) / self.focal[0], (v - self.centre[1]) / self.focal[1], 1.0]
    }

    /// Where a point is seen; somewhere far out if it is behind.
    pub fn project(&self, point: &Vector3<f64>) -> [f64; 2] {
        let p = self.c2w.rotation.transpose() * (point - self.c2w.translation);
        let z = p.z.max(1e-6);
        // upstream multiplies first, so that a point behind is not where its direction is
        [(self.focal[0] * p.x + self.centre[0] * p.z) / z, (self.focal[1] * p.y + self.centre[1] * p.z) / z]
    }
}
