//! The splats that each node carries.

use super::bound::NODE;
use crate::gpu::Gpu;
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::sort::{Pairs, Sort};
use crate::launch;
use cubecl::prelude::*;

/// Where the entries of each of `nodes` nodes start, and one more, and the entries: four times a
/// bound splat plus its place among the splat's nodes, rising within a node.
pub(super) fn lists(gpu: &Gpu, bindings: &Buffer, n: usize, nodes: usize) -> [Buffer; 2] {
    let client = &gpu.client;
    let starts = Buffer::empty(client, nodes + 1);
    let pairs = Pairs::empty(client, 4 * n);
    launch!(
        client,
        pair::launch,
        (cubes(4 * n, 256), units()),
        [bindings, pairs.keys, pairs.values],
        [n as u32]
    );
    let sort = Sort::new(client, 4 * n);
    let count = Buffer::words(client, &[4 * n as u32]);
    let sorted = sort.run(client, &pairs, &count, key_bits(nodes));
    launch!(
        client,
        start::launch,
        (cubes(nodes + 1, 256), units()),
        [sorted.keys, starts],
        [4 * n as u32, nodes as u32]
    );
    [starts, sorted.values.clone()]
}

/// Bits that tell `nodes` nodes apart, a multiple of what a pass of the sort takes.
fn key_bits(nodes: usize) -> u32 {
    (usize::BITS - nodes.leading_zeros()).next_multiple_of(4)
}

#[cube(launch)]
fn pair(bindings: &[u32], keys: &mut [u32], values: &mut [u32], n: u32) {
    let i = ABSOLUTE_POS as u32;
    if i < 4u32 * n {
        keys[i as usize] = bindings[((NODE as u32 + i % 4u32) * n + i / 4u32) as usize];
        values[i as usize] = i;
    }
}

/// The first of `count` rising keys that is not below each node.
#[cube(launch)]
fn start(keys: &[u32], starts: &mut [u32], count: u32, nodes: u32) {
    let node = ABSOLUTE_POS as u32;
    if node <= nodes {
        let mut low = 0u32;
        let mut high = count;
        while low < high {
            let middle = (low + high) / 2u32;
            if keys[middle as usize] < node {
                low = middle + 1u32;
            } else {
                high = middle;
            }
        }
        starts[node as usize] = low;
    }
}
