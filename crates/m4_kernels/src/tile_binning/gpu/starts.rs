//! Where the list of each tile starts, from the changes of the numbers of entries from tile to
//! tile.

use super::{BUCKETS, LARGE, LARGE_SPLATS, SLOTS, WANTED, buckets_of};
use crate::gpu::scan::scan_units;
use cubecl::prelude::*;

/// Tiles of a unit in a round.
const RUN: u32 = 4;

/// Gives the lists of all tiles their places, in one cube of `units`, and sets the changes of their
/// counts back to 0 for the next frame: the number of entries of a tile is the sum of the changes
/// up to it. A frame that wants more entries than there is room for gets none. `peak` keeps the
/// largest number that a frame wanted.
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
        let mut counts = Array::<u32>::new(RUN as usize);
        let mut change = 0u32;
        #[unroll]
        for k in 0u32..RUN {
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
        for k in 0u32..RUN {
            let mut count = counts[k as usize] + before;
            if wanted > capacity || tile + k >= tiles {
                count = 0u32;
            }
            counts[k as usize] = count;
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
        for k in 0u32..RUN {
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
