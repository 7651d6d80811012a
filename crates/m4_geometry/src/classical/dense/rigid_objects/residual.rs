//! How far the flow of an edge is from what an adjusted geometry says.

use crate::dba::{Factor, Geometry};
use m4_core::Se3;
use nalgebra::Vector3;

/// Direction of a pixel of the grid in the camera, of z 1.
pub(super) fn ray(geometry: &Geometry<f32>, g: usize) -> Vector3<f64> {
    let width = geometry.grid.width;
    ray_at(geometry, (g % width) as f64, (g / width) as f64)
}

/// The same of a place on the grid.
pub(super) fn ray_at(geometry: &Geometry<f32>, x: f64, y: f64) -> Vector3<f64> {
    let lens = &geometry.lens;
    Vector3::new((x - lens.cx) / lens.fx, (y - lens.cy) / lens.fy, 1.0)
}

/// Residual of pixel `g` of an edge with this relative pose, pixels of the grid.
pub(super) fn offset_px(
    geometry: &Geometry<f32>,
    edge: &Factor<f32>,
    relative: &Se3<f64>,
    g: usize,
) -> [f64; 2] {
    let lens = &geometry.lens;
    let d = f64::from(geometry.disparity[edge.source][g]);
    let p = relative.rotation * ray(geometry, g) + relative.translation * d;
    let z = p.z.max(f64::EPSILON);
    [
        lens.fx * p.x / z + lens.cx - f64::from(edge.target_px[0][g]),
        lens.fy * p.y / z + lens.cy - f64::from(edge.target_px[1][g]),
    ]
}
