//! Sorts splats by depth, near to far.

use std::ops::Range;

/// Bits that one pass of the sort looks at.
const DIGIT: u32 = 11;
const SIZE: usize = 1 << DIGIT;
/// Fewer are sorted by comparison.
const FEW: usize = 256;

/// Sorts by depth, ties in the order in which they came.
///
/// Two passes of a radix sort look at the top 22 bits of the depths' range; what these leave equal,
/// a few neighbours at most in an ordinary scene, is put right by insertion.
#[derive(Debug, Default)]
pub(super) struct Order {
    /// Bits of the depth in the high half, index in the low half: all different.
    keys: Vec<u64>,
    other: Vec<u64>,
    least: u64,
    most: u64,
}

impl Order {
    /// Makes room for `n` keys, which the caller sets.
    pub(super) fn resize(&mut self, n: usize) {
        self.keys.resize(n, 0);
    }

    /// The least and the greatest of the keys.
    pub(super) fn set_range(&mut self, least: u64, most: u64) {
        (self.least, self.most) = (least, most);
    }

    /// Some of the keys.
    #[inline(always)]
    pub(super) fn keys(&mut self, at: Range<usize>) -> &mut [u64] {
        &mut self.keys[at]
    }

    /// Key of number `index` at a depth, which is above 0: then its bits are in the order of
    /// depths.
    #[inline(always)]
    pub(super) fn key(depth: f32, index: u32) -> u64 {
        u64::from(depth.to_bits()) << 32 | u64::from(index)
    }

    pub(super) fn len(&self) -> usize {
        self.keys.len()
    }

    /// What came as number `index(n)` is at place `n`, once [`sort`](Self::sort) has been called.
    #[inline(always)]
    pub(super) fn index(&self, n: usize) -> u32 {
        self.keys[n] as u32
    }

    pub(super) fn sort(&mut self) {
        if self.keys.len() < FEW {
            self.keys.sort_unstable();
        } else {
            self.radix();
            insert(&mut self.keys);
        }
    }

    fn radix(&mut self) {
        let least = (self.least >> 32) as u32;
        let range = (self.most >> 32) as u32 - least;
        let shift = (u32::BITS - range.leading_zeros()).saturating_sub(2 * DIGIT);
        let digit = |key: u64, pass: u32| {
            (((key >> 32) as u32 - least) >> (shift + DIGIT * pass)) as usize % SIZE
        };
        let mut counts = [[0u32; SIZE]; 2];
        for &key in &self.keys {
            counts[0][digit(key, 0)] += 1;
            counts[1][digit(key, 1)] += 1;
        }
        self.other.resize(self.keys.len(), 0);
        for (pass, count) in counts.iter_mut().enumerate() {
            let mut start = 0;
            for c in count.iter_mut() {
                (start, *c) = (start + *c, start);
            }
            for &key in &self.keys {
                let at = &mut count[digit(key, pass as u32)];
                self.other[*at as usize] = key;
                *at += 1;
            }
            std::mem::swap(&mut self.keys, &mut self.other);
        }
    }
}

/// Sorts what is nearly sorted; a wall seen head on is not, and goes to the general sort.
fn insert(keys: &mut [u64]) {
    let mut moves = 8 * keys.len();
    for i in 1..keys.len() {
        let key = keys[i];
        let mut at = i;
        while at > 0 && keys[at - 1] > key {
            keys[at] = keys[at - 1];
            at -= 1;
        }
        keys[at] = key;
        moves = moves.saturating_sub(i - at);
        if moves == 0 {
            keys.sort_unstable();
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Order;
    use m4_core::CounterRng;

    #[test]
    fn near_to_far_and_ties_as_they_came() {
        let mut rng = CounterRng::new(3, 0, 0);
        let far = |_: usize| 1e6f32;
        let mut scenes: Vec<Vec<f32>> = vec![vec![], vec![2.0], vec![1.5; 3000]];
        for n in [255, 256, 4000] {
            scenes.push(
                (0..n)
                    .map(|_| 0.05 + (30.0 * rng.uniform()) as f32)
                    .collect(),
            );
            // many ties
            scenes.push(
                (0..n)
                    .map(|_| 1.0 + (8.0 * rng.uniform()).floor() as f32)
                    .collect(),
            );
            // a wall seen head on, its depths apart by less than the passes can tell, and one splat
            // far away
            let wall = (0..n).map(|_| f32::from_bits(1.0f32.to_bits() + rng.below(64) as u32));
            scenes.push(wall.chain([0].map(far)).collect());
        }
        let mut order = Order::default();
        for depths in scenes {
            order.resize(depths.len());
            for (index, (key, &depth)) in order
                .keys(0..depths.len())
                .iter_mut()
                .zip(&depths)
                .enumerate()
            {
                *key = Order::key(depth, index as u32);
            }
            let keys = order.keys(0..depths.len());
            let (least, most) = (keys.iter().min().copied(), keys.iter().max().copied());
            order.set_range(least.unwrap_or(0), most.unwrap_or(0));
            let mut want: Vec<u32> = (0..depths.len() as u32).collect();
            want.sort_by(|&i, &j| depths[i as usize].total_cmp(&depths[j as usize]));
            order.sort();
            let got: Vec<u32> = (0..order.len()).map(|n| order.index(n)).collect();
            assert_eq!(got, want);
        }
    }
}
