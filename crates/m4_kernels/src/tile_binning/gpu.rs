//! Binning: turns ellipses into depth-ordered tile lists.
use crate::gpu::eye::SIZE;
use cubecl::prelude::*;
use reach::{REACH, Reach, tile_rows, tile_span};

pub(crate) mod reach;

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
