//! Random numbers that depend on a key, not on the order of calls.

/// A counter-based generator: the stream is a pure function of its key.
///
/// Two threads that draw from generators with different keys cannot disturb one another, and a
/// resumed run draws what the uninterrupted one would have drawn: the state to save is the counter
/// alone. The mixing function is SplitMix64 (Steele, Lea and Flood 2014).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CounterRng {
    key: u64,
    counter: u64,
}

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl CounterRng {
    /// The stream of `seed`, `purpose` (what the numbers are for) and `index` (iteration, splat,
    /// ...).
    pub fn new(seed: u64, purpose: u64, index: u64) -> Self {
        let key = Self::base(seed, purpose).wrapping_add(mix(index ^ 0x517c_c1b7_2722_0a95));
        Self { key, counter: 0 }
    }

    /// The part of a stream's key that the index has no part in: for GPUs, which make the rest.
    pub fn base(seed: u64, purpose: u64) -> u64 {
        mix(mix(seed ^ 0x9e37_79b9_7f4a_7c15).wrapping_add(purpose))
    }

    /// 64 uniform bits.
    pub fn next_u64(&mut self) -> u64 {
        self.counter = self.counter.wrapping_add(1);
        mix(self
            .key
            .wrapping_add(self.counter.wrapping_mul(0x9e37_79b9_7f4a_7c15)))
    }

    /// Uniform in `[0, 1)`, 53 bits.
    pub fn uniform(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniform in `0..n`; 0 when `n` is 0.
    pub fn below(&mut self, n: usize) -> usize {
        ((self.uniform() * n as f64) as usize).min(n.saturating_sub(1))
    }

    /// Standard normal (Box-Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// `count` different numbers below `n` in random order; all of them when `count >= n`.
    pub fn sample(&mut self, n: usize, count: usize) -> Vec<usize> {
        let mut all: Vec<usize> = (0..n).collect();
        let count = count.min(n);
        for i in 0..count {
            let j = i + self.below(n - i);
            all.swap(i, j);
        }
        all.truncate(count);
        all
    }
}

#[cfg(test)]
mod tests {
    use super::CounterRng;

    #[test]
    fn a_stream_depends_on_every_part_of_its_key() {
        let first = |s, p, i| CounterRng::new(s, p, i).next_u64();
        assert_eq!(first(1, 2, 3), first(1, 2, 3));
        assert_ne!(first(1, 2, 3), first(2, 2, 3));
        assert_ne!(first(1, 2, 3), first(1, 3, 3));
        assert_ne!(first(1, 2, 3), first(1, 2, 4));
    }

    #[test]
    fn moments_are_those_of_the_distribution() {
        let mut rng = CounterRng::new(7, 0, 0);
        let n = 100_000;
        let (mut sum, mut square, mut flat) = (0.0, 0.0, 0.0);
        for _ in 0..n {
            let x = rng.normal();
            sum += x;
            square += x * x;
            flat += rng.uniform();
        }
        let n = f64::from(n);
        assert!(
            (sum / n).abs() < 0.02
                && (square / n - 1.0).abs() < 0.03
                && (flat / n - 0.5).abs() < 0.01
        );
    }

    #[test]
    fn a_sample_has_no_duplicates() {
        let mut picked = CounterRng::new(3, 1, 4).sample(12, 10);
        picked.sort_unstable();
        picked.dedup();
        assert_eq!(picked.len(), 10);
        assert_eq!(CounterRng::new(3, 1, 4).sample(3, 10).len(), 3);
    }
}
