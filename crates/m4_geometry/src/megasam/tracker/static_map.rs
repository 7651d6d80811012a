//! Finds static pixels by how well they follow the motion of the camera.

use crate::dba::{Geometry, Robust, project};
use crate::megasam::graph::GraphEdge;
use rayon::prelude::*;

/// The mean robust weight of every pixel over the edges that start in its frame, `[frames][height * width]`: near 1
/// where the flow is that of a static scene, near 0 where something else moves. Points that the target does not
/// see do not vote, nor do components without confidence; a pixel without votes gets 1.
#[must_use]
pub fn confidence_from_residuals(
    geometry: &Geometry<f32>,
    edges: &[GraphEdge],
    robust: Robust,
    min_depth: f64,
) -> Vec<Vec<f32>> {
    (0..geometry.frames())
        .into_par_iter()
        .map(|frame| {
            let mut votes = vec![(0.0_f32, 0_u32); geometry.grid.len()];
            for edge in edges.iter().filter(|e| e.factor.source == frame) {
                let f = &edge.factor;
                let g = geometry.relative(f.source, f.target);
                for (n, vote) in votes.iter_mut().enumerate() {
                    let (u, v) = ((n % geometry.grid.width) as f64, (n / geometry.grid.width) as f64);
                    let p = project(&g, &geometry.lens, 1.0, u, v, f64::from(geometry.disparity[frame][n]));
                    if p.z <= min_depth || f.weight[0][n] + f.weight[1][n] <= 0.0 {
                        continue;
                    }
                    let du = f64::from(f.target_px[0][n]) - p.pixel.x;
                    let dv = f64::from(f.target_px[1][n]) - p.pixel.y;
                    vote.0 += robust.weight(du * du + dv * dv) as f32;
                    vote.1 += 1;
                }
            }
            let mean = |(sum, count): (f32, u32)| if count == 0 { 1.0 } else { sum / count as f32 };
            votes.into_iter().map(mean).collect()
        })
        .collect()
}
