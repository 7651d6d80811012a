//! Sorts the list of each tile near to far, splats of one depth by their rows: one cube per tile.
//! Lists of up to 1,024 entries are sorted in shared memory; longer ones in pieces of as many,
//! which are merged.

use super::buckets_of;
use cubecl::prelude::*;

/// Entries that are sorted at once.
const PIECE: u32 = 1024;
/// Units of a cube: most lists have a few dozen entries.
pub(crate) const UNITS: u32 = 128;
/// In place of a slot after the end of a list.
const NO_SLOT: u32 = 0xffff_ffff;

/// Sorts each tile's entries and writes, in their order, the slot and the splat of each. `ranges`
/// get the ends of the lists, which can be shorter than counted; `tile_of` gets the tile of each
/// bucket.
#[cube(launch)]
pub(crate) fn sort_lists(
    ranges: &mut [u32],
    cursors: &[u32],
    buckets: &[u32],
    keys: &mut [u32],
    slots: &mut [u32],
    sorted_keys: &mut [u32],
    sorted_slots: &mut [u32],
    splat_of_slot: &[u32],
    splats: &mut [u32],
    tile_of: &mut [u32],
    tiles: u32,
) {
    let mut piece_keys = Shared::<[u32]>::new_slice(1024usize);
    let mut piece_slots = Shared::<[u32]>::new_slice(1024usize);
    let tile = CUBE_POS as u32;
    if tile < tiles {
        let start = ranges[(2u32 * tile) as usize];
        let counted = ranges[(2u32 * tile + 1u32) as usize];
        let end = cursors[tile as usize].min(counted);
        let count = end - start;
        // a bucket that was counted and has no entry belongs to its tile, too
        let first_bucket = buckets[tile as usize];
        let mut k = UNIT_POS;
        while k < buckets_of(counted - start) {
            let to = (first_bucket + k) as usize;
            if to < tile_of.len() {
                tile_of[to] = tile;
            }
            k += UNITS;
        }
        // the passes alternate between the two memories and end in the second
        let mut passes = 0u32;
        let mut width = PIECE.runtime();
        while width < count {
            width *= 2u32;
            passes += 1u32;
        }
        let mut piece = 0u32;
        while piece < count {
            let here = (count - piece).min(PIECE);
            let mut size = 2u32;
            while size < here {
                size *= 2u32;
            }
            let mut k = UNIT_POS;
            while k < size {
                let mut key = 0xffff_ffffu32;
                let mut slot = NO_SLOT.runtime();
                if k < here {
                    key = keys[(start + piece + k) as usize];
                    slot = slots[(start + piece + k) as usize];
                }
                piece_keys[k as usize] = key;
                piece_slots[k as usize] = slot;
                k += UNITS;
            }
            sync_cube();
            sort_piece(&mut piece_keys, &mut piece_slots, splat_of_slot, size);
            let mut k = UNIT_POS;
            while k < here {
                let to = (start + piece + k) as usize;
                if passes % 2u32 == 0u32 {
                    sorted_keys[to] = piece_keys[k as usize];
                    sorted_slots[to] = piece_slots[k as usize];
                } else {
                    keys[to] = piece_keys[k as usize];
                    slots[to] = piece_slots[k as usize];
                }
                k += UNITS;
            }
            sync_storage();
            piece += PIECE;
        }
        let mut width = PIECE.runtime();
        let mut pass = 0u32;
        while width < count {
            if (passes - pass) % 2u32 == 0u32 {
                merge(
                    sorted_keys,
                    sorted_slots,
                    keys,
                    slots,
                    splat_of_slot,
                    start,
                    count,
                    width,
                );
            } else {
                merge(
                    keys,
                    slots,
                    sorted_keys,
                    sorted_slots,
                    splat_of_slot,
                    start,
                    count,
                    width,
                );
            }
            sync_storage();
            width *= 2u32;
            pass += 1u32;
        }
        let mut k = UNIT_POS;
        while k < count {
            let at = (start + k) as usize;
            splats[at] = splat_of_slot[sorted_slots[at] as usize];
            k += UNITS;
        }
        if UNIT_POS == 0u32 {
            ranges[(2u32 * tile + 1u32) as usize] = end;
        }
    }
}

/// Whether entry `a` comes before entry `b`, which is another one.
#[cube]
fn is_before(key_a: u32, slot_a: u32, key_b: u32, slot_b: u32, splat_of_slot: &[u32]) -> bool {
    let mut before = key_a < key_b;
    if key_a == key_b {
        // every slot comes before none
        before = slot_a < slot_b;
        if slot_a != NO_SLOT && slot_b != NO_SLOT {
            before = splat_of_slot[slot_a as usize] < splat_of_slot[slot_b as usize];
        }
    }
    before
}

/// A bitonic sort of the first `size` entries, a power of two.
#[cube]
fn sort_piece(
    keys: &mut Shared<[u32]>,
    slots: &mut Shared<[u32]>,
    splat_of_slot: &[u32],
    size: u32,
) {
    let mut run = 2u32;
    while run <= size {
        let mut step = run / 2u32;
        while step > 0u32 {
            let mut pair = UNIT_POS;
            while pair < size / 2u32 {
                let low = pair % step;
                let a = (2u32 * (pair - low) + low) as usize;
                let b = a + step as usize;
                let rises = (a as u32 & run) == 0u32;
                let (key_a, slot_a, key_b, slot_b) = (keys[a], slots[a], keys[b], slots[b]);
                let falls_here = is_before(key_b, slot_b, key_a, slot_a, splat_of_slot);
                // CUDA's compiler has no comparison of truth values
                if (falls_here && rises) || (!falls_here && !rises) {
                    keys[a] = key_b;
                    slots[a] = slot_b;
                    keys[b] = key_a;
                    slots[b] = slot_a;
                }
                pair += UNITS;
            }
            sync_cube();
            step /= 2u32;
        }
        run *= 2u32;
    }
}

/// Merges neighbouring runs of `width` entries: each entry moves up by as many as come before it in
/// the other run.
#[cube]
fn merge(
    keys: &mut [u32],
    slots: &mut [u32],
    to_keys: &mut [u32],
    to_slots: &mut [u32],
    splat_of_slot: &[u32],
    start: u32,
    count: u32,
    width: u32,
) {
    let mut k = UNIT_POS;
    while k < count {
        let key = keys[(start + k) as usize];
        let slot = slots[(start + k) as usize];
        let run = k / width;
        // the other run of the pair
        let mut first = (run + 1u32) * width;
        let mut base = run * width;
        if run % 2u32 == 1u32 {
            first = (run - 1u32) * width;
            base = first;
        }
        let begin = first.min(count);
        let mut low = begin;
        let mut high = (first + width).min(count);
        while low < high {
            let middle = (low + high) / 2u32;
            let at = (start + middle) as usize;
            if is_before(keys[at], slots[at], key, slot, splat_of_slot) {
                low = middle + 1u32;
            } else {
                high = middle;
            }
        }
        let to = (start + base + k - run * width + low - begin) as usize;
        to_keys[to] = key;
        to_slots[to] = slot;
        k += UNITS;
    }
}

#[cfg(test)]
mod tests {
    use super::sort_lists;
    use crate::gpu::buffer::{Buffer, cubes};
    use crate::gpu::device::tests::gpu;
    use crate::launch;
    use cubecl::prelude::CubeDim;
    use m4_core::CounterRng;

    /// Entries of the lists, in memory one after the other.
    const LENGTHS: [usize; 9] = [0, 1, 2, 31, 1024, 1025, 3000, 0, 9000];
    /// Entries that were counted and not made.
    const MISSING: usize = 40;

    #[test]
    fn lists_are_in_the_order_of_depth_and_row() {
        let Some(gpu) = gpu("lists_are_in_the_order_of_depth_and_row") else {
            return;
        };
        let client = &gpu.client;
        let mut rng = CounterRng::new(7, 0, 0);
        let (mut ranges, mut cursors, mut buckets) = (Vec::new(), Vec::new(), Vec::new());
        let (mut start, mut bucket) = (0, 0);
        for length in LENGTHS {
            let counted = length + MISSING;
            ranges.extend([start, start + counted]);
            cursors.push(start + length);
            buckets.push(bucket);
            start += counted;
            bucket += counted.div_ceil(32);
        }
        let words = |values: &[usize]| -> Vec<u32> { values.iter().map(|&v| v as u32).collect() };
        // seven depths only, so that most entries have one in common with others
        let keys: Vec<u32> = (0..start).map(|_| (rng.uniform() * 7.0) as u32).collect();
        let slots: Vec<u32> = rng
            .sample(start, start)
            .into_iter()
            .map(|slot| slot as u32)
            .collect();
        let splat_of_slot: Vec<u32> = rng
            .sample(start, start)
            .into_iter()
            .map(|splat| splat as u32)
            .collect();
        let buffer = |values: &[u32]| Buffer::words(client, values);
        let empty = |len| Buffer::empty(client, len);
        let [range_buffer, sorted, splats, tile_of] = [
            buffer(&words(&ranges)),
            empty(start),
            empty(start),
            empty(bucket),
        ];
        launch!(
            client,
            sort_lists::launch,
            (cubes(LENGTHS.len(), 1), CubeDim::new_1d(super::UNITS)),
            [
                range_buffer,
                buffer(&words(&cursors)),
                buffer(&words(&buckets)),
                buffer(&keys),
                buffer(&slots),
                empty(start),
                sorted,
                buffer(&splat_of_slot),
                splats,
                tile_of
            ],
            [LENGTHS.len() as u32]
        );
        let read = |buffer: &Buffer| buffer.read_words(client, "sorting").unwrap();
        let (ends, sorted, splats, tile_of) = (
            read(&range_buffer),
            read(&sorted),
            read(&splats),
            read(&tile_of),
        );
        for (tile, length) in LENGTHS.into_iter().enumerate() {
            let here = ranges[2 * tile]..ranges[2 * tile] + length;
            assert_eq!(ends[2 * tile + 1] as usize, here.end, "tile {tile}");
            let mut want: Vec<u32> = slots[here.clone()].to_vec();
            let key_of: std::collections::HashMap<u32, u32> = here
                .clone()
                .map(|entry| (slots[entry], keys[entry]))
                .collect();
            want.sort_by_key(|slot| (key_of[slot], splat_of_slot[*slot as usize]));
            assert!(
                sorted[here.clone()] == want,
                "slots of tile {tile}, {length} entries"
            );
            let want: Vec<u32> = want
                .iter()
                .map(|&slot| splat_of_slot[slot as usize])
                .collect();
            assert!(
                splats[here] == want,
                "splats of tile {tile}, {length} entries"
            );
            let end = buckets.get(tile + 1).map_or(bucket, |&next| next);
            assert!(
                tile_of[buckets[tile]..end]
                    .iter()
                    .all(|&of| of as usize == tile),
                "buckets of tile {tile}"
            );
        }
    }
}
