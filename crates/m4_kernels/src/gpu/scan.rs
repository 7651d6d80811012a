//! Sums over cubes, and exclusive sums.

#![expect(
    missing_docs,
    reason = "`cube` generates items beside those that it is written at"
)]

use crate::gpu::buffer::{Buffer, cubes, units};
use crate::launch;
use cubecl::prelude::*;

/// Numbers a cube: 256 units with four each.
pub(crate) const BLOCK: usize = 1024;

/// Sum over the cube's 256 units; every unit gets it.
#[cube]
pub fn cube_sum(value: f32, shared: &mut Shared<[f32]>) -> f32 {
    sync_cube();
    shared[UNIT_POS as usize] = value;
    sync_cube();
    let mut half = 128u32;
    while half > 0u32 {
        if UNIT_POS < half {
            let other = shared[(UNIT_POS + half) as usize];
            shared[UNIT_POS as usize] += other;
        }
        sync_cube();
        half /= 2u32;
    }
    shared[0]
}

/// Exclusive sum of one value per unit over a cube of 256.
#[cube]
pub fn scan_cube(value: u32, shared: &mut Shared<[u32]>) -> u32 {
    scan_units(value, shared, 256u32)
}

/// Exclusive sum of one value per unit over a cube of `units`, a power of two; `shared` then has
/// the inclusive ones.
#[cube]
pub(crate) fn scan_units(value: u32, shared: &mut Shared<[u32]>, #[comptime] units: u32) -> u32 {
    let unit = UNIT_POS as usize;
    shared[unit] = value;
    sync_cube();
    let mut step = 1u32;
    while step < units {
        let mut add = 0u32;
        if UNIT_POS >= step {
            add = shared[unit - step as usize];
        }
        sync_cube();
        shared[unit] += add;
        sync_cube();
        step *= 2u32;
    }
    shared[unit] - value
}

#[cube(launch)]
fn scan_blocks(input: &[u32], output: &mut [u32], totals: &mut [u32], n: u32) {
    let mut shared = Shared::<[u32]>::new_slice(256usize);
    let block = CUBE_POS as u32;
    let first = (block * 256u32 + UNIT_POS) * 4u32;
    let mut sum = 0u32;
    for k in 0u32..4u32 {
        if first + k < n {
            sum += input[(first + k) as usize];
        }
    }
    let mut before = scan_cube(sum, &mut shared);
    if UNIT_POS == 255u32 && block < totals.len() as u32 {
        totals[block as usize] = before + sum;
    }
    for k in 0u32..4u32 {
        if first + k < n {
            output[(first + k) as usize] = before;
            before += input[(first + k) as usize];
        }
    }
}

/// All in one cube, block after block.
#[cube(launch)]
fn scan_in_one(input: &[u32], output: &mut [u32], totals: &mut [u32], n: u32) {
    let mut shared = Shared::<[u32]>::new_slice(256usize);
    let mut carry = 0u32;
    let mut start = 0u32;
    while start < n {
        let first = start + UNIT_POS * 4u32;
        let mut sum = 0u32;
        for k in 0u32..4u32 {
            if first + k < n {
                sum += input[(first + k) as usize];
            }
        }
        let mut before = carry + scan_cube(sum, &mut shared);
        for k in 0u32..4u32 {
            if first + k < n {
                output[(first + k) as usize] = before;
                before += input[(first + k) as usize];
            }
        }
        carry += shared[255usize];
        // the next block is written where this sum was read
        sync_cube();
        start += 1024u32;
    }
    if UNIT_POS == 0u32 {
        totals[0usize] = carry;
    }
}

#[cube(launch)]
fn add_totals(output: &mut [u32], totals: &[u32], n: u32) {
    let block = CUBE_POS as u32;
    let first = (block * 256u32 + UNIT_POS) * 4u32;
    for k in 0u32..4u32 {
        if first + k < n {
            output[(first + k) as usize] += totals[block as usize];
        }
    }
}

/// This many numbers are one cube's work: a few rounds there are sooner done than two more
/// launches.
const IN_ONE: usize = 8 * BLOCK;

/// Exclusive sums of as many numbers every time.
#[derive(Debug)]
pub struct Scan {
    n: usize,
    totals: Buffer,
    /// The sums of the totals, where there is more than one.
    above: Option<(Buffer, Box<Scan>)>,
}

impl Scan {
    /// Memory for `n` numbers.
    pub fn new(client: &Client, n: usize) -> Self {
        let blocks = if n <= IN_ONE { 1 } else { n.div_ceil(BLOCK) };
        let above = (blocks > 1).then(|| {
            (
                Buffer::empty(client, blocks),
                Box::new(Self::new(client, blocks)),
            )
        });
        Self {
            n,
            totals: Buffer::empty(client, blocks),
            above,
        }
    }

    /// The numbers in each of its buffers.
    pub fn lengths(n: usize) -> Vec<usize> {
        let blocks = if n <= IN_ONE { 1 } else { n.div_ceil(BLOCK) };
        let mut out = vec![blocks];
        if blocks > 1 {
            out.push(blocks);
            out.extend(Self::lengths(blocks));
        }
        out
    }

    /// `output[i]` becomes the sum of `input[..i]`.
    pub fn run(&self, client: &Client, input: &Buffer, output: &Buffer) {
        let n = self.n as u32;
        if self.n <= IN_ONE {
            launch!(
                client,
                scan_in_one::launch,
                (cubes(1, 1), units()),
                [input, output, self.totals],
                [n]
            );
            return;
        }
        let count = cubes(self.n, BLOCK);
        launch!(
            client,
            scan_blocks::launch,
            (count, units()),
            [input, output, self.totals],
            [n]
        );
        if let Some((offsets, above)) = &self.above {
            above.run(client, &self.totals, offsets);
            launch!(
                client,
                add_totals::launch,
                (cubes(self.n, BLOCK), units()),
                [output, offsets],
                [n]
            );
        }
    }

    /// One number: the sum of everything.
    pub fn total(&self) -> &Buffer {
        self.above
            .as_ref()
            .map_or(&self.totals, |(_, above)| above.total())
    }
}

#[cfg(test)]
mod tests {
    use super::{BLOCK, IN_ONE, Scan};
    use crate::gpu::buffer::Buffer;
    use crate::gpu::device::tests::gpu;
    use m4_core::CounterRng;

    #[test]
    fn sums_are_those_of_a_loop() {
        let Some(gpu) = gpu("sums_are_those_of_a_loop") else {
            return;
        };
        let client = &gpu.client;
        for n in [1, 5, BLOCK, BLOCK + 1, IN_ONE, IN_ONE + 1, 70_001] {
            let mut rng = CounterRng::new(n as u64, 0, 0);
            let input: Vec<u32> = (0..n).map(|_| (rng.uniform() * 1e4) as u32).collect();
            let output = Buffer::empty(client, n);
            let scan = Scan::new(client, n);
            scan.run(client, &Buffer::words(client, &input), &output);
            let mut sum = 0;
            let want: Vec<u32> = input
                .iter()
                .map(|v| {
                    sum += v;
                    sum - v
                })
                .collect();
            assert!(
                output.read_words(client, "scanning").unwrap() == want,
                "{n} numbers"
            );
            assert_eq!(
                scan.total().read_words(client, "scanning").unwrap()[0],
                sum,
                "{n} numbers"
            );
        }
    }
}
