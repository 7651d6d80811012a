//! The tiles that an ellipse reaches, exactly (docs/spec/optimiser.md 5.2): per row of tiles, those between the leftmost and the rightmost point of the
//! ellipse within that row.

use cubecl::prelude::*;

/// Pixels along a side of a tile.
pub(crate) const TILE: usize = 16;
/// Added to both sides of an ellipse, pixels: kernels that round differently agree on its tiles.
const SLACK_PX: f32 = 0.005;
/// Numbers of a reach in memory.
pub(crate) const REACH: usize = 6;

/// Where an ellipse lies and how far it reaches.
#[derive(CubeType, Clone, Copy)]
pub(crate) struct Reach {
    /// Centre, pixels.
    pub u: f32,
    pub v: f32,
    /// Low-passed covariance.
    pub v00: f32,
    pub v01: f32,
    pub v11: f32,
    /// Squared Mahalanobis radius at which alpha falls under the threshold.
    pub radius: f32,
    /// Size of the image.
    pub width: f32,
    pub height: f32,
}

/// First row of tiles that an ellipse reaches, and the one after the last.
#[cube]
pub(crate) fn tile_rows(r: &Reach) -> (u32, u32) {
    let half = (r.radius * r.v11).sqrt() + SLACK_PX;
    let top = (r.v - half).ceil().max(0.0f32);
    let bottom = (r.v + half).floor().min(r.height - 1.0f32);
    let mut first = 0u32;
    let mut end = 0u32;
    if top <= bottom {
        first = u32::cast_from(top) / 16u32;
        end = u32::cast_from(bottom) / 16u32 + 1u32;
    }
    (first, end)
}

/// First tile of a row that an ellipse reaches, and the one after the last.
#[cube]
pub(crate) fn tile_span(r: &Reach, row: u32) -> (u32, u32) {
    let half = (r.radius * r.v11).sqrt() + SLACK_PX;
    let reach_x = (r.radius * r.v00).sqrt();
    let right_at = r.v01 * reach_x / r.v00;
    let inverse = 1.0f32 / r.v11;
    let det = r.v00 * r.v11 - r.v01 * r.v01;
    let across = (det * inverse).max(0.0f32);
    let slope = r.v01 * inverse;
    let low = (f32::cast_from(row * 16u32) - r.v).max(-half);
    let high = (f32::cast_from(row * 16u32) + 15.0f32 - r.v).min(half);
    let y = right_at.max(low).min(high);
    let right = r.u + slope * y + ((r.radius - y * y * inverse) * across).max(0.0f32).sqrt() + SLACK_PX;
    let y = (-right_at).max(low).min(high);
    let left = r.u + slope * y - ((r.radius - y * y * inverse) * across).max(0.0f32).sqrt() - SLACK_PX;
    let left = left.ceil().max(0.0f32);
    let right = right.floor().min(r.width - 1.0f32);
    let mut first = 0u32;
    let mut end = 0u32;
    if low <= high && left <= right {
        first = u32::cast_from(left) / 16u32;
        end = u32::cast_from(right) / 16u32 + 1u32;
    }
    (first, end)
}
