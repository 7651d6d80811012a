//! How a pixel with a disparity is seen in another frame, and all derivatives of that: the reference.
//!
//! The homogeneous point of pixel `(u, v)` with disparity `d` is `((u - cx)/fx, (v - cy)/fy, 1, d)`, and `G` acts
//! on it as `R X + d t`, so the depth `1/d` is never formed.

use super::problem::Pinhole;
use m4_core::{
    Real, Se3,
    nalgebra::{Matrix2x6, Matrix6, Vector2, Vector3, Vector6},
};

/// Below this scaled depth the projection divides by 1 instead; such a point is never valid.
pub const PROJECTION_GUARD: f64 = 0.1;

/// Least scaled depth `z` in the target of a valid point, as in the published solver for graphics
/// processors. Its Python twin has 0.2.
pub const MIN_DEPTH: f64 = 0.25;

/// One pixel as the target frame sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projected<T: Real> {
    /// Position, pixels of the grid.
    pub pixel: Vector2<T>,
    /// Depth in the target times the disparity in the source: 1 for a static camera.
    pub z: T,
    /// With respect to the left twist of the target's pose.
    pub by_target: Matrix2x6<T>,
    /// With respect to the left twist of the source's pose.
    pub by_source: Matrix2x6<T>,
    /// With respect to the disparity.
    pub by_disparity: Vector2<T>,
    /// With respect to the focal parameter `fx / (2 cx)`.
    pub by_focal: Vector2<T>,
}

/// Projects pixel `(u, v)` of disparity `d` by `g = G_ij`. `fy_rate` is the change of `fy` with that of `fx`:
/// their ratio where both follow one parameter.
pub fn project<T: Real>(g: &Se3<T>, lens: &Pinhole<T>, fy_rate: T, u: T, v: T, d: T) -> Projected<T> {
    let (one, zero) = (T::one(), T::zero());
    let ray = Vector3::new((u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy, one);
    let p = g.rotation * ray + g.translation * d;
    let (x, y, z) = (p.x, p.y, p.z);
    let iz = one / if z < T::of(PROJECTION_GUARD) { one } else { z };
    let (a, b) = (lens.fx * iz, lens.fy * iz);
    // Rows of the derivative of the pixel by the point.
    let (by_u, by_v) = (Vector3::new(a, zero, -a * x * iz), Vector3::new(zero, b, -b * y * iz));
    let row = |j: &Vector3<T>| {
        let turn = p.cross(j);
        Vector6::new(d * j.x, d * j.y, d * j.z, turn.x, turn.y, turn.z).transpose()
    };
    let by_target = Matrix2x6::from_rows(&[row(&by_u), row(&by_v)]);
    // The ray bends as the focal length grows.
    let bend = g.rotation * Vector3::new(-ray.x / lens.fx, -ray.y * fy_rate / lens.fy, zero);
    let scale = T::of(2.0) * lens.cx;
    Projected {
        pixel: Vector2::new(a * x + lens.cx, b * y + lens.cy),
        z,
        by_target,
        by_source: -(by_target * g.adjoint()),
        by_disparity: Vector2::new(by_u.dot(&g.translation), by_v.dot(&g.translation)),
        by_focal: Vector2::new(x * iz + by_u.dot(&bend), fy_rate * y * iz + by_v.dot(&bend)) * scale,
    }
}

/// `Ad(G_ij)^T` with the sign that turns what is known of the target into what is known of the source:
/// `H_ij = -M H_jj`, `v_i = -M v_j`, `E_i = -M E_j`.
pub(crate) fn source_from_target(g: &Se3<f64>) -> Matrix6<f64> {
    -g.adjoint().transpose()
}
