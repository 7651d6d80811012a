//! Measures the limits of a GPU, as [`Probe::run`] does those of the CPU.

use super::Probe;
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::{Gpu, GpuError};
use crate::launch;
use cubecl::prelude::*;
use std::time::{Duration, Instant};

/// Bytes of each of the two arrays that are streamed, at most: more than caches of devices hold.
const STREAM_BYTES: usize = 128 << 20;
/// Cubes of the multiply-adds.
const CUBES: usize = 4096;
/// Multiply-adds of a unit: rounds times chains.
const ROUNDS: u32 = 256;
const CHAINS: usize = 8;
/// How long a rate is measured, so that starting and waiting do not count.
const LONG: Duration = Duration::from_millis(60);

/// `a[i] += s b[i]`.
#[cube(launch)]
fn stream(a: &mut [f32], b: &[f32]) {
    if ABSOLUTE_POS < a.len() {
        a[ABSOLUTE_POS] += 0.5f32 * b[ABSOLUTE_POS];
    }
}

/// Independent multiply-adds in registers.
#[cube(launch)]
fn multiply(out: &mut [f32], factor: f32) {
    let mut a = factor;
    let mut b = factor + 1.0f32;
    let mut c = factor + 2.0f32;
    let mut d = factor + 3.0f32;
    let mut e = factor + 4.0f32;
    let mut f = factor + 5.0f32;
    let mut g = factor + 6.0f32;
    let mut h = factor + 7.0f32;
    for _ in 0u32..256u32 {
        a = fma(a, factor, factor);
        b = fma(b, factor, factor);
        c = fma(c, factor, factor);
        d = fma(d, factor, factor);
        e = fma(e, factor, factor);
        f = fma(f, factor, factor);
        g = fma(g, factor, factor);
        h = fma(h, factor, factor);
    }
    if ABSOLUTE_POS < out.len() {
        out[ABSOLUTE_POS] = a + b + c + d + e + f + g + h;
    }
}

impl Probe {
    /// Rates of the device over arrays that its caches do not hold, measured now, on 256 MB. Fails
    /// with [`GpuError`] if the device fails.
    pub fn of_device(gpu: &Gpu) -> Result<Self, GpuError> {
        let client = &gpu.client;
        let len = STREAM_BYTES.min(gpu.adapter().max_buffer_bytes as usize) / 4;
        let (a, b) = (Buffer::empty(client, len), Buffer::empty(client, len));
        let bytes_per_s = rate(gpu, 12.0 * len as f64, || {
            launch!(client, stream::launch, (cubes(len, 256), units()), [a, b]);
        })?;
        let out = Buffer::empty(client, 256 * CUBES);
        let operations = (256 * CUBES * CHAINS) as f64 * f64::from(ROUNDS);
        let operations_per_s = rate(gpu, operations, || {
            launch!(
                client,
                multiply::launch,
                (cubes(256 * CUBES, 256), units()),
                [out],
                [0.5]
            );
        })?;
        Ok(Self {
            bytes_per_s,
            operations_per_s,
        })
    }
}

/// Work a second: as many launches behind one another as take long enough.
fn rate(gpu: &Gpu, work: f64, launch: impl Fn()) -> Result<f64, GpuError> {
    const DOING: &str = "measuring the device";
    launch();
    gpu.wait(DOING)?;
    let mut launches = 1;
    loop {
        let start = Instant::now();
        for _ in 0..launches {
            launch();
        }
        gpu.wait(DOING)?;
        let took = start.elapsed();
        if took >= LONG || launches >= 1 << 14 {
            return Ok(work * launches as f64 / took.as_secs_f64().max(1e-9));
        }
        launches *= 2;
    }
}
