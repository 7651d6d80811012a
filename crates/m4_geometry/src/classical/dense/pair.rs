//! Where a pixel of one camera appears in another, as a function of its disparity.

use m4_core::{
    Camera,
    nalgebra::{Matrix3, Vector3},
};

/// `q ~ a (x, y, 1) + disparity b`, pixel coordinates with the centre of the first pixel at 0, 0.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pair {
    pub a: [[f32; 3]; 3],
    pub b: [f32; 3],
}

/// A pixel with a disparity, seen from the other camera.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reprojected {
    pub x: f32,
    pub y: f32,
    /// Of the same point in the other camera; not above 0 when it lies behind that camera.
    pub disparity: f32,
}

fn intrinsics(camera: &Camera) -> Matrix3<f64> {
    let k = &camera.intrinsics;
    Matrix3::new(k.fx, 0.0, k.cx - 0.5, 0.0, k.fy, k.cy - 0.5, 0.0, 0.0, 1.0)
}

fn inverse_intrinsics(camera: &Camera) -> Matrix3<f64> {
    let k = &camera.intrinsics;
    let (x, y) = ((k.cx - 0.5) / k.fx, (k.cy - 0.5) / k.fy);
    Matrix3::new(1.0 / k.fx, 0.0, -x, 0.0, 1.0 / k.fy, -y, 0.0, 0.0, 1.0)
}

impl Pair {
    pub fn new(from: &Camera, to: &Camera) -> Self {
        let motion = to.w2c().compose(&from.c2w);
        let a = intrinsics(to) * motion.rotation * inverse_intrinsics(from);
        let b: Vector3<f64> = intrinsics(to) * motion.translation;
        Self {
            a: std::array::from_fn(|r| std::array::from_fn(|c| a[(r, c)] as f32)),
            b: std::array::from_fn(|r| b[r] as f32),
        }
    }

    /// The part that does not depend on disparity.
    pub fn ray(&self, x: f32, y: f32) -> [f32; 3] {
        self.a.map(|row| row[0] * x + row[1] * y + row[2])
    }

    pub fn project(&self, x: f32, y: f32, disparity: f32) -> Reprojected {
        let r = self.ray(x, y);
        let z = 1.0 / (r[2] + disparity * self.b[2]);
        Reprojected {
            x: (r[0] + disparity * self.b[0]) * z,
            y: (r[1] + disparity * self.b[1]) * z,
            disparity: disparity * z,
        }
    }
}

/// Displacement of a point at disparity `disparity` in the middle of the image because of the
/// translation between two cameras alone, pixels.
pub(super) fn parallax_px(from: &Camera, to: &Camera, disparity: f64) -> f64 {
    let pair = Pair::new(from, to);
    let k = &from.intrinsics;
    let (x, y) = ((k.width as f32 - 1.0) / 2.0, (k.height as f32 - 1.0) / 2.0);
    let (far, near) = (pair.project(x, y, 0.0), pair.project(x, y, disparity as f32));
    if far.disparity.is_finite() && near.disparity > 0.0 {
        f64::from((near.x - far.x).hypot(near.y - far.y))
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::{Pair, parallax_px};
    use m4_core::{Camera, Intrinsics, Se3, nalgebra::Vector6};

    #[test]
    fn projects_as_the_cameras_do() {
        let camera = |twist: Vector6<f64>| Camera {
            intrinsics: Intrinsics { cx: 30.0, ..Intrinsics::centred(64, 48, 50.0) },
            c2w: Se3::identity().retract(&twist),
        };
        let a = camera(Vector6::new(0.1, 0.0, -0.2, 0.05, 0.1, 0.0));
        let b = camera(Vector6::new(-0.2, 0.3, 0.1, -0.1, 0.02, 0.2));
        let (x, y, z) = (20.0, 31.0, 2.5);
        let ([u, v], depth) = b.project(&a.unproject(x, y, z));
        let seen = Pair::new(&a, &b).project(x as f32, y as f32, (1.0 / z) as f32);
        assert!((f64::from(seen.x) - u).abs() < 1e-3 && (f64::from(seen.y) - v).abs() < 1e-3, "{seen:?} {u} {v}");
        assert!((1.0 / f64::from(seen.disparity) - depth).abs() < 1e-4);
    }

    #[test]
    fn parallax_is_focal_times_baseline_times_disparity() {
        let still = Camera { intrinsics: Intrinsics::centred(64, 48, 50.0), c2w: Se3::identity() };
        let aside = Camera { c2w: still.c2w.retract(&Vector6::new(0.3, 0.0, 0.0, 0.0, 0.0, 0.0)), ..still };
        assert!((parallax_px(&still, &aside, 0.5) - 50.0 * 0.3 * 0.5).abs() < 1e-3);
        assert_eq!(parallax_px(&still, &still, 0.5), 0.0);
    }
}
