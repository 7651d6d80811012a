//! Ranks scores: the best that may be densified, and the range in which prune scores are measured.

use crate::config::PruneRule;
use cubecl::prelude::*;
use m4_kernels::gpu::buffer::{Buffer, cubes, units};
use m4_kernels::gpu::keys::{float_of, key_of};
use m4_kernels::gpu::sort::{Pairs, Sort};
use m4_kernels::gpu::tally::is_finite;
use m4_kernels::launch;

/// In place of the key of a score that does not count; it comes last.
const LAST: u32 = u32::MAX;

/// Memory for sorting the scores of `n` splats.
pub(crate) struct Rank {
    n: usize,
    pairs: Pairs,
    sort: Sort,
    count: Buffer,
}

impl Rank {
    pub fn new(client: &Client, n: usize) -> Self {
        Self {
            n,
            pairs: Pairs::empty(client, n),
            sort: Sort::new(client, n),
            count: Buffer::words(client, &[n as u32]),
        }
    }

    /// 1 for the splats that are cloned or split, else 0: `[n]`. They are the `budget` best of
    /// those above `threshold`; ties go to the lower row.
    pub fn best(&self, client: &Client, threshold: f32, budget: usize, scores: &Buffer) -> Buffer {
        let n = self.n as u32;
        if budget == 0 {
            return Buffer::zeros(client, self.n);
        }
        let grows = Buffer::empty(client, self.n);
        launch!(
            client,
            grow_keys::launch,
            (cubes(self.n, 256), units()),
            [scores, self.pairs.keys, self.pairs.values],
            [n, threshold]
        );
        let sorted = self.sort.run(client, &self.pairs, &self.count, 32);
        launch!(
            client,
            take_best::launch,
            (cubes(self.n, 256), units()),
            [sorted.keys, sorted.values, grows],
            [n, u32::try_from(budget).unwrap_or(u32::MAX)]
        );
        grows
    }

    /// The scores that become 0 and 1; the second is not larger if nothing is to be pruned
    /// (Minute4D Eq. 10).
    pub fn prune_range(&self, client: &Client, rule: PruneRule, scores: &Buffer) -> Buffer {
        let n = self.n as u32;
        let (literal, quantile) = match rule {
            PruneRule::Literal => (true, 1.0),
            PruneRule::WithOpacity { quantile, .. } => (false, quantile.clamp(0.0, 1.0)),
        };
        let range = Buffer::empty(client, 2);
        launch!(
            client,
            prune_keys::launch,
            (cubes(self.n, 256), units()),
            [scores, self.pairs.keys],
            [n, literal]
        );
        let sorted = self.sort.run(client, &self.pairs, &self.count, 32);
        launch!(
            client,
            find_range::launch,
            (cubes(1, 1), CubeDim::new_1d(1)),
            [sorted.keys, range],
            [n, quantile, literal]
        );
        range
    }
}

/// Keys that put the highest scores first, of those above the threshold.
#[cube(launch)]
fn grow_keys(scores: &[f32], keys: &mut [u32], rows: &mut [u32], n: u32, threshold: f32) {
    let i = ABSOLUTE_POS as u32;
    if i < n {
        let score = scores[i as usize];
        let mut key = 0xffff_ffffu32;
        if is_finite(score) && score > threshold {
            key = !key_of(score);
        }
        keys[i as usize] = key;
        rows[i as usize] = i;
    }
}

#[cube(launch)]
fn take_best(keys: &[u32], rows: &[u32], grows: &mut [u32], n: u32, budget: u32) {
    let p = ABSOLUTE_POS as u32;
    if p < n {
        let mut grow = 0u32;
        if p < budget && keys[p as usize] != LAST {
            grow = 1u32;
        }
        grows[rows[p as usize] as usize] = grow;
    }
}

/// Keys that put the lowest scores first, of those that count.
#[cube(launch)]
fn prune_keys(scores: &[f32], keys: &mut [u32], n: u32, #[comptime] literal: bool) {
    let i = ABSOLUTE_POS as u32;
    if i < n {
        let score = scores[(n + i) as usize];
        let mut key = 0xffff_ffffu32;
        if is_finite(score) {
            if comptime!(literal) {
                key = key_of(score);
            } else {
                if score > 0.0f32 {
                    key = key_of(score);
                }
            }
        }
        keys[i as usize] = key;
    }
}

#[cube(launch)]
fn find_range(keys: &[u32], range: &mut [f32], n: u32, quantile: f32, #[comptime] literal: bool) {
    if ABSOLUTE_POS == 0 {
        let mut start = 0u32;
        let mut end = n;
        while start < end {
            let middle = (start + end) / 2u32;
            if keys[middle as usize] == LAST {
                end = middle;
            } else {
                start = middle + 1u32;
            }
        }
        range[0usize] = 0.0f32;
        range[1usize] = 0.0f32;
        if start > 0u32 {
            let last = start - 1u32;
            range[0usize] = float_of(keys[0usize]);
            if comptime!(literal) {
                range[1usize] = float_of(keys[last as usize]).max(0.0f32);
            } else {
                let place = u32::cast_from(f32::cast_from(last) * quantile).min(last);
                range[1usize] = float_of(keys[place as usize]);
            }
        }
    }
}
