//! Exclusive sums.

use crate::buffer::{Buffer, cubes, units};
use cubecl::prelude::*;

/// Numbers a cube: 256 units with four each.
pub(crate) const BLOCK: usize = 1024;

/// Exclusive sum of one value a unit over a cube of 256.
#[cube]
pub(crate) fn scan_cube(value: u32, shared: &mut Shared<[u32]>) -> u32 {
    let unit = UNIT_POS as usize;
    shared[unit] = value;
    sync_cube();
    let mut step = 1u32;
    while step < 256u32 {
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

/// Exclusive sums of as many numbers every time.
#[derive(Debug)]
pub(crate) struct Scan {
    n: usize,
    totals: Buffer,
    /// The sums of the totals, where there is more than one.
    above: Option<(Buffer, Box<Scan>)>,
}

impl Scan {
    /// Memory for `n` numbers.
    pub fn new(client: &Client, n: usize) -> Self {
        let blocks = n.div_ceil(BLOCK).max(1);
        let above = (blocks > 1).then(|| (Buffer::empty(client, blocks), Box::new(Self::new(client, blocks))));
        Self {
            n,
            totals: Buffer::empty(client, blocks),
            above,
        }
    }

    /// `output[i]` becomes the sum of `input[..i]`.
    pub fn run(&self, client: &Client, input: &Buffer, output: &Buffer) {
        let n = self.n as u32;
        let count = cubes(self.n, BLOCK);
        scan_blocks::launch(client, count, units(), input.arg(), output.arg(), self.totals.arg(), n);
        if let Some((offsets, above)) = &self.above {
            above.run(client, &self.totals, offsets);
            add_totals::launch(client, cubes(self.n, BLOCK), units(), output.arg(), offsets.arg(), n);
        }
    }

    /// One number: the sum of everything.
    pub fn total(&self) -> &Buffer {
        self.above.as_ref().map_or(&self.totals, |(_, above)| above.total())
    }
}
