//! Binning: turns ellipses into depth-ordered tile lists without sorting everything. Splats note in each row of tiles where
//! their count changes (`project`), a scan over the tiles gives each list its place, splats write themselves into the lists,
//! and a cube per tile sorts its list ([`sort`]).

use crate::gpu::scan::{scan_cube, scan_units};
use crate::gpu::vector::SIZE;
use cubecl::prelude::*;

pub(crate) mod sort;

/// Of [`tile_starts`]' totals: entries that the frame wants, whether or not there is room for them.
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

/// A splat in more tiles than this is large: a whole cube writes its entries and adds up its gradients.
pub(crate) const MANY: u32 = 64;
/// Cubes that share the large splats.
pub(crate) const LARGE_CUBES: usize = 512;

/// Tiles of a unit in a round of [`tile_starts`].
const RUN: u32 = 4;

/// Gives the lists of all tiles their places, in one cube of `units`, and sets the changes of their counts back to 0 for the next
/// frame: the number of entries of a tile is the sum of the changes up to it. A frame that wants more entries than there is room for
/// gets none. `peak` keeps the largest number that a frame wanted.
#[cube(launch)]
pub(crate) fn tile_starts(
    changes: &mut [u32],
    allocated: &mut [u32],
    ranges: &mut [u32],
    cursors: &mut [u32],
    buckets: &mut [u32],
    totals: &mut [u32],
    peak: &mut [u32],
    tiles: u32,
    capacity: u32,
    #[comptime] units: u32,
) {
    let mut shared = Shared::<[u32]>::new_slice(units as usize);
    let last = comptime!(units as usize - 1);
    let wanted = allocated[SLOTS];
    // before the round: entries of the tile, entries and buckets of all tiles
    let mut level = 0u32;
    let mut entries = 0u32;
    let mut bucket = 0u32;
    let mut start = 0u32;
    while start < tiles {
        let tile = start + RUN * UNIT_POS;
        let mut counts = Array::<u32>::new(4usize);
        let mut change = 0u32;
        #[unroll]
        for k in 0u32..4u32 {
            let at = (tile + k) as usize;
            if tile + k < tiles {
                change += changes[at];
                changes[at] = 0u32;
            }
            counts[k as usize] = change;
        }
        let before = level + scan_units(change, &mut shared, units);
        level += shared[last];
        sync_cube();
        let mut mine = 0u32;
        let mut filled = 0u32;
        #[unroll]
        for k in 0usize..4usize {
            let mut count = counts[k] + before;
            if wanted > capacity || tile + k as u32 >= tiles {
                count = 0u32;
            }
            counts[k] = count;
            mine += count;
            filled += buckets_of(count);
        }
        let mut first = entries + scan_units(mine, &mut shared, units);
        entries += shared[last];
        sync_cube();
        let mut first_bucket = bucket + scan_units(filled, &mut shared, units);
        bucket += shared[last];
        sync_cube();
        #[unroll]
        for k in 0u32..4u32 {
            let at = (tile + k) as usize;
            let count = counts[k as usize];
            if tile + k < tiles {
                ranges[2 * at] = first;
                ranges[2 * at + 1] = first + count;
                cursors[at] = first;
                buckets[at] = first_bucket;
            }
            first += count;
            first_bucket += buckets_of(count);
        }
        start += RUN * units;
    }
    if UNIT_POS == 0u32 {
        totals[WANTED] = wanted;
        totals[BUCKETS] = bucket;
        totals[LARGE] = allocated[LARGE_SPLATS];
        peak[0] = peak[0].max(wanted);
        allocated[SLOTS] = 0u32;
        allocated[LARGE_SPLATS] = 0u32;
        changes[tiles as usize] = 0u32;
    }
}

/// Buckets that hold `count` entries.
#[cube]
pub(crate) fn buckets_of(count: u32) -> u32 {
    (count + 31u32) / 32u32
}

/// One entry for every tile that a splat reaches which is not large, anywhere in the tile's list; `counts` become the numbers that were
/// made. The units of a cube share the entries of its 256 splats.
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
        let (tile, made) = nth_tile(&reach, nth, across);
        if tile != NO_TILE {
            let slot = offsets[splat as usize] + nth;
            write_entry(tile, splat, slot, depths, ranges, cursors, keys, slots, splats);
        }
        // the first that was counted and is not there
        if tile == NO_TILE && nth == made {
            counts[splat as usize] = made;
        }
        t += 256u32;
    }
}

/// As [`emit`], for large splats: a cube takes one after the other, a unit a row of tiles at first and then tiles.
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
        let mut made = 0u32;
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
            while t < tiles.min(count - made) {
                let row = last_from(&starts, t) as usize;
                let tile = firsts[row] + t - starts[row];
                write_entry(tile, splat, slot + made + t, depths, ranges, cursors, keys, slots, splats);
                t += 256u32;
            }
            made += tiles.min(count - made);
            top += 256u32;
            sync_cube();
        }
        if UNIT_POS == 0u32 {
            counts[splat as usize] = made;
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

/// The tile of number `nth`, row by row, that an ellipse reaches, and how many there are up to its row. [`NO_TILE`], and how many there
/// are at all, if there are not that many.
#[cube]
fn nth_tile(reach: &Reach, nth: u32, across: u32) -> (u32, u32) {
    let mut tile = NO_TILE.runtime();
    let mut made = 0u32;
    let (first, end) = tile_rows(reach, SLACK_PX);
    let mut row = first;
    while row < end && tile == NO_TILE {
        let (left, right) = tile_span(reach, row, SLACK_PX);
        if nth < made + right - left {
            tile = row * across + left + nth - made;
        }
        made += right - left;
        row += 1u32;
    }
    (tile, made)
}

/// Pixels along a side of a tile.
pub const TILE: usize = 8;
const SIDE: u32 = TILE as u32;
/// The last pixel of a row, from the first.
const LAST: f32 = TILE as f32 - 1.0;
/// Added to both sides of an ellipse, pixels: kernels that round differently agree on its tiles.
pub(crate) const SLACK_PX: f32 = 0.005;
/// Added when tiles are counted: what rounds differently when entries are made must not find more tiles than were counted.
const COUNT_SLACK_PX: f32 = 0.007;
/// The same, as a share of the coordinates.
const COUNT_SLACK: f32 = 4e-6;
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
    let right = r.u + slope * y + ((r.radius - y * y * inverse) * across).max(0.0f32).sqrt() + slack;
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
