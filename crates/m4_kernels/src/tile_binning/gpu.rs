//! Binning: turns ellipses into depth-ordered tile lists.

use crate::gpu::vector::SIZE;
use cubecl::prelude::*;

/// `out[i] = values[order[i]]`.
#[cube(launch)]
pub(crate) fn pick(order: &[u32], values: &[u32], count: &[u32], out: &mut [u32]) {
    let i = ABSOLUTE_POS as u32;
    if i < count[0].min(out.len() as u32) {
        out[i as usize] = values[order[i as usize] as usize];
    }
}

/// The largest number of entries of any frame so far.
#[cube(launch)]
pub(crate) fn note_peak(count: &[u32], peak: &mut [u32]) {
    if ABSOLUTE_POS == 0 {
        peak[0] = peak[0].max(count[0]);
    }
}

/// Tile counts in the order of depth.
#[cube(launch)]
pub(crate) fn gather(order: &[u32], counts: &[u32], out: &mut [u32], n: u32) {
    let i = ABSOLUTE_POS as u32;
    if i < n {
        out[i as usize] = counts[order[i as usize] as usize];
    }
}

/// One entry for every tile that a splat reaches, splats near to far, as long as there is room; `counts` become those
/// that were made.
#[cube(launch)]
pub(crate) fn emit(
    order: &[u32],
    counts: &mut [u32],
    offsets: &[u32],
    reaches: &[f32],
    eye: &[f32],
    keys: &mut [u32],
    splats: &mut [u32],
    slots: &mut [u32],
    n: u32,
    across: u32,
) {
    let p = ABSOLUTE_POS as u32;
    if p < n {
        let count = counts[p as usize];
        if count > 0u32 {
            let splat = order[p as usize];
            let mut slot = offsets[p as usize];
            let mut end_slot = slot + count;
            if end_slot > keys.len() as u32 {
                end_slot = keys.len() as u32;
            }
            let r = splat as usize * REACH;
            let reach = Reach {
                u: reaches[r],
                v: reaches[r + 1],
                v00: reaches[r + 2],
                v01: reaches[r + 3],
                v11: reaches[r + 4],
                radius: reaches[r + 5],
                width: eye[SIZE],
                height: eye[SIZE + 1],
            };
            let (first, end) = tile_rows(&reach);
            for row in first..end {
                let (left, right) = tile_span(&reach, row);
                for column in left..right {
                    if slot < end_slot {
                        keys[slot as usize] = row * across + column;
                        splats[slot as usize] = splat;
                        slots[slot as usize] = slot;
                        slot += 1u32;
                    }
                }
            }
            // two kernels may round differently: what was counted and not found lies in no tile
            counts[p as usize] = slot - offsets[p as usize].min(slot);
            while slot < end_slot {
                keys[slot as usize] = 0xffff_ffffu32;
                splats[slot as usize] = splat;
                slots[slot as usize] = slot;
                slot += 1u32;
            }
        }
    }
}

/// Where each tile's entries start and end.
#[cube(launch)]
pub(crate) fn ranges(keys: &[u32], count: &[u32], ranges: &mut [u32], capacity: u32, tiles: u32) {
    let i = ABSOLUTE_POS as u32;
    let n = count[0].min(capacity);
    if i < n {
        let tile = keys[i as usize];
        if tile < tiles {
            let mut starts = i == 0u32;
            if !starts {
                starts = keys[(i - 1u32) as usize] != tile;
            }
            if starts {
                ranges[(2u32 * tile) as usize] = i;
            }
            let mut ends = i + 1u32 == n;
            if !ends {
                ends = keys[(i + 1u32) as usize] != tile;
            }
            if ends {
                ranges[(2u32 * tile + 1u32) as usize] = i + 1u32;
            }
        }
    }
}

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
