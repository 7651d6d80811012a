//! Writes each splat into the lists of the tiles that it reaches.

use super::{LARGE, MANY, REACH, Reach, SLACK_PX, WANTED, tile_rows, tile_span};
use crate::gpu::scan::scan_cube;
use crate::gpu::vector::SIZE;
use cubecl::prelude::*;

/// One entry for every tile that a splat reaches which is not large, anywhere in the tile's list;
/// `counts` become the numbers that were made. The units of a cube share the entries of its 256
/// splats.
#[cube(launch)]
pub(crate) fn emit(
    counts: &mut [u32],
    offsets: &[u32],
    reaches: &[f32],
    depths: &[u32],
    eye: &[f32],
    ranges: &[u32],
    cursors: &[Atomic<u32>],
    keys: &mut [u32],
    slots: &mut [u32],
    splats: &mut [u32],
    totals: &[u32],
    n: u32,
    across: u32,
    capacity: u32,
) {
    // entries before each splat's
    let mut starts = Shared::<[u32]>::new_slice(256usize);
    let mut all = Shared::<[u32]>::new_slice(1usize);
    let cube = ABSOLUTE_POS as u32 - UNIT_POS;
    let i = cube + UNIT_POS;
    let mut count = 0u32;
    if i < n {
        count = counts[i as usize];
        if totals[WANTED] > capacity {
            counts[i as usize] = 0u32;
            count = 0u32;
        }
        if count > MANY {
            count = 0u32;
        }
    }
    let start = scan_cube(count, &mut starts);
    sync_cube();
    starts[UNIT_POS as usize] = start;
    if UNIT_POS == 255u32 {
        all[0] = start + count;
    }
    let end = workgroup_uniform_load(&all[0]);
    let mut t = UNIT_POS;
    while t < end {
        let owner = last_from(&starts, t);
        let splat = cube + owner;
        let nth = t - starts[owner as usize];
        let reach = reach_of(reaches, splat, eye);
        let (tile, n_tiles) = nth_tile(&reach, nth, across);
        if tile != NO_TILE {
            let slot = offsets[splat as usize] + nth;
            write_entry(
                tile, splat, slot, depths, ranges, cursors, keys, slots, splats,
            );
        }
        // the first that was counted and is not there
        if tile == NO_TILE && nth == n_tiles {
            counts[splat as usize] = n_tiles;
        }
        t += 256u32;
    }
}

/// As `emit`, for large splats: a cube takes one after the other, a unit a row of tiles at first
/// and then tiles.
#[cube(launch)]
pub(crate) fn emit_large(
    counts: &mut [u32],
    offsets: &[u32],
    reaches: &[f32],
    depths: &[u32],
    eye: &[f32],
    ranges: &[u32],
    cursors: &[Atomic<u32>],
    keys: &mut [u32],
    slots: &mut [u32],
    splats: &mut [u32],
    large: &[u32],
    totals: &[u32],
    across: u32,
    capacity: u32,
) {
    // tiles before each row's, and the first of each
    let mut starts = Shared::<[u32]>::new_slice(256usize);
    let mut firsts = Shared::<[u32]>::new_slice(256usize);
    let mut all = Shared::<[u32]>::new_slice(1usize);
    let mut number = totals[LARGE];
    if totals[WANTED] > capacity {
        number = 0u32;
    }
    let mut next = CUBE_POS as u32;
    while next < number {
        let splat = large[next as usize];
        let count = counts[splat as usize];
        let slot = offsets[splat as usize];
        let reach = reach_of(reaches, splat, eye);
        let (first, end) = tile_rows(&reach, SLACK_PX);
        let mut n_entries = 0u32;
        let mut top = first;
        while top < end {
            let row = top + UNIT_POS;
            let mut left = 0u32;
            let mut columns = 0u32;
            if row < end {
                let (from, to) = tile_span(&reach, row, SLACK_PX);
                left = from;
                columns = to - from;
            }
            let start = scan_cube(columns, &mut starts);
            sync_cube();
            starts[UNIT_POS as usize] = start;
            firsts[UNIT_POS as usize] = row * across + left;
            if UNIT_POS == 255u32 {
                all[0] = start + columns;
            }
            let tiles = workgroup_uniform_load(&all[0]);
            let mut t = UNIT_POS;
            while t < tiles.min(count - n_entries) {
                let row = last_from(&starts, t) as usize;
                let tile = firsts[row] + t - starts[row];
                write_entry(
                    tile,
                    splat,
                    slot + n_entries + t,
                    depths,
                    ranges,
                    cursors,
                    keys,
                    slots,
                    splats,
                );
                t += 256u32;
            }
            n_entries += tiles.min(count - n_entries);
            top += 256u32;
            sync_cube();
        }
        if UNIT_POS == 0u32 {
            counts[splat as usize] = n_entries;
        }
        next += CUBE_COUNT as u32;
    }
}

/// The last of 256 places whose start is `t` or less.
#[cube]
fn last_from(starts: &Shared<[u32]>, t: u32) -> u32 {
    let mut low = 0u32;
    let mut step = 128u32;
    while step > 0u32 {
        if starts[(low + step) as usize] <= t {
            low += step;
        }
        step /= 2u32;
    }
    low
}

/// Writes an entry into the list of its tile.
#[cube]
fn write_entry(
    tile: u32,
    splat: u32,
    slot: u32,
    depths: &[u32],
    ranges: &[u32],
    cursors: &[Atomic<u32>],
    keys: &mut [u32],
    slots: &mut [u32],
    splats: &mut [u32],
) {
    let place = cursors[tile as usize].fetch_add(1u32);
    if place < ranges[(2u32 * tile + 1u32) as usize] {
        keys[place as usize] = depths[splat as usize];
        slots[place as usize] = slot;
        splats[slot as usize] = splat;
    }
}

/// The reach of a splat from memory.
#[cube]
fn reach_of(reaches: &[f32], splat: u32, eye: &[f32]) -> Reach {
    let r = splat as usize * REACH;
    Reach {
        u: reaches[r],
        v: reaches[r + 1],
        v00: reaches[r + 2],
        v01: reaches[r + 3],
        v11: reaches[r + 4],
        radius: reaches[r + 5],
        width: eye[SIZE],
        height: eye[SIZE + 1],
    }
}

/// In place of a tile.
const NO_TILE: u32 = 0xffff_ffff;

/// The tile of number `nth`, row by row, that an ellipse reaches, and how many there are up to its
/// row. [`NO_TILE`], and how many there are at all, if there are not that many.
#[cube]
fn nth_tile(reach: &Reach, nth: u32, across: u32) -> (u32, u32) {
    let mut tile = NO_TILE.runtime();
    let mut count = 0u32;
    let (first, end) = tile_rows(reach, SLACK_PX);
    let mut row = first;
    while row < end && tile == NO_TILE {
        let (left, right) = tile_span(reach, row, SLACK_PX);
        if nth < count + right - left {
            tile = row * across + left + nth - count;
        }
        count += right - left;
        row += 1u32;
    }
    (tile, count)
}
