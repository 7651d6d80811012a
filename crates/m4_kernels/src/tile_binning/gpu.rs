//! Binning: turns ellipses into depth-ordered tile lists without sorting everything. Splats note in
//! each row of tiles where their count changes (`project`), a scan over the tiles gives each list
//! its place, splats write themselves into the lists, and a cube per tile sorts its list.

use cubecl::prelude::*;

pub(crate) mod entries;
pub(crate) mod sort;
pub(crate) mod starts;

/// Of the totals: entries that the frame wants, whether or not there is room for them.
pub(crate) const WANTED: usize = 0;
/// Buckets of 32 entries.
pub(crate) const BUCKETS: usize = 1;
/// Splats in more than [`MANY`] tiles, as counted.
pub(crate) const LARGE: usize = 2;
/// How many totals there are.
pub(crate) const TOTALS: usize = 3;

/// What `project` hands out: slots,
pub(crate) const SLOTS: usize = 0;
/// and places in the list of large splats.
pub(crate) const LARGE_SPLATS: usize = 1;
/// How many kinds there are.
pub(crate) const ALLOCATED: usize = 2;

/// A splat in more tiles than this is large: a whole cube writes its entries and adds up its
/// gradients.
pub(crate) const MANY: u32 = 64;
/// Cubes that share the large splats.
pub(crate) const LARGE_CUBES: usize = 512;

/// Buckets that hold `count` entries.
#[cube]
pub(crate) fn buckets_of(count: u32) -> u32 {
    (count + 31u32) / 32u32
}

/// Pixels along a side of a tile.
pub const TILE: usize = 8;
const SIDE: u32 = TILE as u32;
/// The last pixel of a row, from the first.
const LAST: f32 = TILE as f32 - 1.0;
/// Added to both sides of an ellipse, pixels: kernels that round differently agree on its tiles.
pub(crate) const SLACK_PX: f32 = 0.005;
/// Added when tiles are counted: what rounds differently when entries are made must not find more
/// tiles than were counted.
const COUNT_SLACK_PX: f32 = 0.007;
/// The same, as a share of the coordinates.
const COUNT_SLACK: f32 = 4e-6;
/// Numbers of a record: centre, half conic 00, conic 01, half conic 11 (times log2 e), log2 of the
/// opacity, red, green, blue, z-depth.
pub(crate) const RECORD: usize = 10;
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

/// The slack with which tiles are counted.
#[cube]
pub(crate) fn count_slack(r: &Reach) -> f32 {
    let size = r.u.abs() + r.v.abs() + (r.radius * r.v00).sqrt() + (r.radius * r.v11).sqrt();
    COUNT_SLACK_PX + COUNT_SLACK * size
}

/// First row of tiles that an ellipse reaches, and the one after the last.
#[cube]
pub(crate) fn tile_rows(r: &Reach, slack: f32) -> (u32, u32) {
    let half = (r.radius * r.v11).sqrt() + slack;
    let top = (r.v - half).ceil().max(0.0f32);
    let bottom = (r.v + half).floor().min(r.height - 1.0f32);
    let mut first = 0u32;
    let mut end = 0u32;
    if top <= bottom {
        first = u32::cast_from(top) / SIDE;
        end = u32::cast_from(bottom) / SIDE + 1u32;
    }
    (first, end)
}

/// First tile of a row that an ellipse reaches, and the one after the last.
#[cube]
pub(crate) fn tile_span(r: &Reach, row: u32, slack: f32) -> (u32, u32) {
    let half = (r.radius * r.v11).sqrt() + slack;
    let reach_x = (r.radius * r.v00).sqrt();
    let right_at = r.v01 * reach_x / r.v00;
    let inverse = 1.0f32 / r.v11;
    let det = r.v00 * r.v11 - r.v01 * r.v01;
    let across = (det * inverse).max(0.0f32);
    let slope = r.v01 * inverse;
    let low = (f32::cast_from(row * SIDE) - r.v).max(-half);
    let high = (f32::cast_from(row * SIDE) + LAST - r.v).min(half);
    let y = right_at.max(low).min(high);
    let right =
        r.u + slope * y + ((r.radius - y * y * inverse) * across).max(0.0f32).sqrt() + slack;
    let y = (-right_at).max(low).min(high);
    let left = r.u + slope * y - ((r.radius - y * y * inverse) * across).max(0.0f32).sqrt() - slack;
    let left = left.ceil().max(0.0f32);
    let right = right.floor().min(r.width - 1.0f32);
    let mut first = 0u32;
    let mut end = 0u32;
    if low <= high && left <= right {
        first = u32::cast_from(left) / SIDE;
        end = u32::cast_from(right) / SIDE + 1u32;
    }
    (first, end)
}
