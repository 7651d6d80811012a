//! Measures the limits of the machine.

use crate::{
    SimdLevel,
    simd::{LANES, all, dispatch},
};
use fearless_simd::{Simd, f32x16, prelude::*};
use fearless_simd_macros::simd;
use std::hint::black_box;
use std::time::{Duration, Instant};

/// Peak rates of blending on one core: useful pixel-gaussian evaluations per second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PeakEvaluations {
    /// [`SimdLevel::name`].
    pub level: &'static str,
    /// Forward.
    pub forward: f64,
    /// Backward.
    pub backward: f64,
}

/// The best loops that we know, on one 8x8 tile in the first-level cache with every lane alive:
/// measured on one core of an AMD EPYC at 4.4 GHz, 2026-11-20. AVX-512: no branch on data,
/// prefetch; AVX2: hand-written intrinsics forward; SSE2: portable vectors. They are constants, not
/// scaled to the machine: on another one they are a yardstick, not a bound. Other instruction sets
/// have none yet.
pub const PEAK_EVALUATIONS: [PeakEvaluations; 3] = [
    PeakEvaluations {
        level: "sse2",
        forward: 0.96e9,
        backward: 0.61e9,
    },
    PeakEvaluations {
        level: "avx2",
        forward: 2.5e9,
        backward: 1.13e9,
    },
    PeakEvaluations {
        level: "avx512",
        forward: 6.7e9,
        backward: 2.55e9,
    },
];

/// How long a probe runs on each thread.
const PROBE: Duration = Duration::from_millis(40);

/// Rates of this machine, all threads of rayon's current pool together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Probe {
    /// `a[i] += s * b[i]` over arrays of some size: 12 bytes per number (two read, one written).
    pub bytes_per_s: f64,
    /// Independent multiply-adds in registers, one operation a lane.
    pub operations_per_s: f64,
}

impl Probe {
    /// Measures for about a tenth of a second; `bytes` is the size of both arrays, all threads
    /// together. Give it what a step moves: what fits a cache moves at the speed of that cache.
    pub fn run(level: SimdLevel, bytes: usize) -> Self {
        let threads = rayon::current_num_threads();
        let len = (bytes / (2 * size_of::<f32>() * threads)).max(1024);
        let rates = rayon::broadcast(|_| (stream(level, len), multiply(level)));
        Self {
            bytes_per_s: rates.iter().map(|r| r.0).sum(),
            operations_per_s: rates.iter().map(|r| r.1).sum(),
        }
    }
}

/// The fastest pass decides: what else runs on the machine only slows passes down.
fn best_rate(work: f64, mut pass: impl FnMut()) -> f64 {
    let start = Instant::now();
    let mut best = f64::INFINITY;
    let mut passes = 0;
    while passes < 3 || start.elapsed() < PROBE {
        let from = Instant::now();
        pass();
        best = best.min(from.elapsed().as_secs_f64());
        passes += 1;
    }
    work / best.max(1e-9)
}

/// Bytes a second of one thread.
fn stream(level: SimdLevel, len: usize) -> f64 {
    let (mut a, b) = (vec![1.0f32; len], vec![1e-9f32; len]);
    best_rate((len * 12) as f64, || {
        dispatch!(level.level(), s => add_scaled(s, &mut a, &b));
        black_box(&mut a);
    })
}

#[simd]
fn add_scaled<S: Simd>(s: S, a: &mut [f32], b: &[f32]) {
    let factor = all(s, 0.5);
    for (a, b) in a.chunks_exact_mut(LANES).zip(b.chunks_exact(LANES)) {
        let sum = f32x16::from_slice(s, b).mul_add(factor, f32x16::from_slice(s, a));
        sum.store_slice(a);
    }
}

/// Multiply-adds in a pass, a lane and accumulator.
const ROUNDS: usize = 20_000;

/// Multiply-adds a second of one thread. As many accumulators as registers allow: enough to hide
/// the latency, few enough that none goes to memory.
fn multiply(level: SimdLevel) -> f64 {
    match level.name() {
        "avx512" => multiply_with::<10>(level),
        "avx2" => multiply_with::<6>(level),
        _ => multiply_with::<3>(level),
    }
}

fn multiply_with<const N: usize>(level: SimdLevel) -> f64 {
    best_rate((ROUNDS * N * LANES) as f64, || {
        black_box(dispatch!(level.level(), s => chains::<_, N>(s, black_box(0.5))));
    })
}

#[simd]
fn chains<S: Simd, const N: usize>(s: S, factor: f32) -> f32 {
    let factor = all(s, factor);
    let mut sum = [factor; N];
    for (k, start) in sum.iter_mut().enumerate() {
        *start = all(s, k as f32);
    }
    for _ in 0..ROUNDS {
        for k in 0..N {
            sum[k] = sum[k].mul_add(factor, factor);
        }
    }
    sum.iter().map(|v| v.to_array()[0]).sum()
}

#[cfg(test)]
mod tests {
    use super::Probe;
    use crate::SimdLevel;

    #[test]
    fn probed_rates_are_plausible() {
        for level in SimdLevel::available() {
            let probe = Probe::run(level, 1 << 20);
            assert!(
                (1e8..1e14).contains(&probe.bytes_per_s),
                "{level}: {probe:?}"
            );
            assert!(
                (1e8..1e14).contains(&probe.operations_per_s),
                "{level}: {probe:?}"
            );
        }
    }
}
