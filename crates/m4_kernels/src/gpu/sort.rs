//! Stable radix sort of 32-bit keys with 32-bit values, four bits a pass.
//!
//! Each cube counts the digits of its 1,024 keys; sums over digits first and cubes second say where
//! its keys of each digit go. Counts of two digits share a number, sixteen bits each.

use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::scan::{BLOCK, Scan, scan_cube};
use crate::launch;
use cubecl::prelude::*;

/// Digits of a pass.
const DIGITS: usize = 16;

/// How many of a unit's four keys, from `first` on, have the digit `word`, and in the upper half
/// `word + 8`.
#[cube]
fn count_digits(keys: &[u32], first: u32, n: u32, shift: u32, word: u32) -> u32 {
    let mut count = 0u32;
    for k in 0u32..4u32 {
        if first + k < n {
            let digit = (keys[(first + k) as usize] >> shift) & 15u32;
            if (digit & 7u32) == word {
                count += 1u32 << ((digit >> 3u32) * 16u32);
            }
        }
    }
    count
}

/// How many of a block's keys have each digit: `[16][blocks]`.
#[cube(launch)]
fn histogram(
    keys: &[u32],
    count: &[u32],
    digits: &mut [u32],
    capacity: u32,
    blocks: u32,
    shift: u32,
) {
    let mut sums = Shared::<[u32]>::new_slice(256usize);
    let block = CUBE_POS as u32;
    let n = count[0].min(capacity);
    let first = (block * 256u32 + UNIT_POS) * 4u32;
    if block < blocks {
        for word in 0u32..8u32 {
            let mine = count_digits(keys, first, n, shift, word);
            let before = scan_cube(mine, &mut sums);
            if UNIT_POS == 255u32 {
                let total = before + mine;
                digits[(word * blocks + block) as usize] = total & 65535u32;
                digits[((word + 8u32) * blocks + block) as usize] = total >> 16u32;
            }
            sync_cube();
        }
    }
}

#[cube(launch)]
fn scatter(
    keys: &[u32],
    values: &[u32],
    count: &[u32],
    places: &[u32],
    keys_out: &mut [u32],
    values_out: &mut [u32],
    capacity: u32,
    blocks: u32,
    shift: u32,
) {
    let mut sums = Shared::<[u32]>::new_slice(256usize);
    let block = CUBE_POS as u32;
    let n = count[0].min(capacity);
    let first = (block * 256u32 + UNIT_POS) * 4u32;
    if block < blocks {
        for word in 0u32..8u32 {
            let mine = count_digits(keys, first, n, shift, word);
            let before = scan_cube(mine, &mut sums);
            let mut low = places[(word * blocks + block) as usize] + (before & 65535u32);
            let mut high = places[((word + 8u32) * blocks + block) as usize] + (before >> 16u32);
            for k in 0u32..4u32 {
                if first + k < n {
                    let key = keys[(first + k) as usize];
                    let digit = (key >> shift) & 15u32;
                    if digit == word {
                        keys_out[low as usize] = key;
                        values_out[low as usize] = values[(first + k) as usize];
                        low += 1u32;
                    }
                    if digit == word + 8u32 {
                        keys_out[high as usize] = key;
                        values_out[high as usize] = values[(first + k) as usize];
                        high += 1u32;
                    }
                }
            }
            sync_cube();
        }
    }
}

/// Sorts as many keys every time.
#[derive(Debug)]
pub struct Sort {
    capacity: usize,
    digits: Buffer,
    places: Buffer,
    scan: Scan,
    /// The output of a pass.
    other: Pairs,
}

/// Keys and values.
#[derive(Debug, Clone)]
pub struct Pairs {
    /// Sorted by.
    pub keys: Buffer,
    /// Carried along.
    pub values: Buffer,
}

impl Pairs {
    /// Room for `len` pairs.
    pub fn empty(client: &Client, len: usize) -> Self {
        Self {
            keys: Buffer::empty(client, len),
            values: Buffer::empty(client, len),
        }
    }
}

impl Sort {
    /// Memory for `capacity` pairs.
    pub fn new(client: &Client, capacity: usize) -> Self {
        let digits = DIGITS * capacity.div_ceil(BLOCK).max(1);
        Self {
            capacity,
            digits: Buffer::empty(client, digits),
            places: Buffer::empty(client, digits),
            scan: Scan::new(client, digits),
            other: Pairs::empty(client, capacity),
        }
    }

    /// The numbers in each of its buffers.
    pub fn lengths(capacity: usize) -> Vec<usize> {
        let digits = DIGITS * capacity.div_ceil(BLOCK).max(1);
        let mut out = vec![digits, digits, capacity, capacity];
        out.extend(Scan::lengths(digits));
        out
    }

    /// Sorts the first `count[0]` pairs (at most the capacity) by the lowest `bits` bits of their
    /// keys; equal keys keep their order.
    pub fn run<'a>(
        &'a self,
        client: &Client,
        pairs: &'a Pairs,
        count: &Buffer,
        bits: u32,
    ) -> &'a Pairs {
        let blocks = self.capacity.div_ceil(BLOCK).max(1) as u32;
        let (mut from, mut to) = (pairs, &self.other);
        for shift in (0..bits).step_by(4) {
            launch!(
                client,
                histogram::launch,
                (cubes(self.capacity, BLOCK), units()),
                [from.keys, count, self.digits],
                [self.capacity as u32, blocks, shift]
            );
            self.scan.run(client, &self.digits, &self.places);
            launch!(
                client,
                scatter::launch,
                (cubes(self.capacity, BLOCK), units()),
                [
                    from.keys,
                    from.values,
                    count,
                    self.places,
                    to.keys,
                    to.values
                ],
                [self.capacity as u32, blocks, shift]
            );
            std::mem::swap(&mut from, &mut to);
        }
        from
    }

    /// Where [`run`](Self::run) left what it sorted.
    pub fn result<'a>(&'a self, pairs: &'a Pairs, bits: u32) -> &'a Pairs {
        if bits.div_ceil(4).is_multiple_of(2) {
            pairs
        } else {
            &self.other
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Pairs, Sort};
    use crate::gpu::buffer::Buffer;
    use crate::gpu::device::tests::gpu;
    use m4_core::CounterRng;

    #[test]
    fn keys_are_sorted_and_equal_ones_keep_their_order() {
        let Some(gpu) = gpu("keys_are_sorted_and_equal_ones_keep_their_order") else {
            return;
        };
        let client = &gpu.client;
        // capacity, keys that count, bits looked at, largest key
        for (capacity, count, bits, most) in [
            (1, 1, 32, 1e9),
            (1000, 1000, 32, 4e9),
            (5000, 3333, 12, 4000.0),
            (40_000, 40_000, 16, 7.0),
            (2000, 2000, 8, 1e9),
            (300, 900, 12, 4000.0),
        ] {
            let mut rng = CounterRng::new(capacity as u64, 0, 0);
            let keys: Vec<u32> = (0..capacity)
                .map(|_| (rng.uniform() * most) as u32)
                .collect();
            let values: Vec<u32> = (0..capacity as u32).collect();
            let pairs = Pairs {
                keys: Buffer::words(client, &keys),
                values: Buffer::words(client, &values),
            };
            let sort = Sort::new(client, capacity);
            let sorted = sort.run(
                client,
                &pairs,
                &Buffer::words(client, &[count as u32]),
                bits,
            );
            let end = count.min(capacity);
            let read =
                |buffer: &Buffer| buffer.read_words(client, "sorting").unwrap()[..end].to_vec();
            let mask = ((1u64 << bits) - 1) as u32;
            let mut want = values[..end].to_vec();
            want.sort_by_key(|&i| keys[i as usize] & mask);
            assert!(
                read(&sorted.values) == want,
                "{count} of {capacity}, {bits} bits"
            );
            let want: Vec<u32> = want.iter().map(|&i| keys[i as usize]).collect();
            assert!(
                read(&sorted.keys) == want,
                "{count} of {capacity}, {bits} bits"
            );
        }
    }
}
