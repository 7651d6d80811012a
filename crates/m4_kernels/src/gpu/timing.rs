//! Times the kernels of a step, and measures the limits of the device as [`crate::bench::Probe`] does for the CPU.

use crate::launch;
use crate::{
    bench::{Kernel, Probe},
    gpu::{
        Gpu, GpuError,
        buffer::{Buffer, cubes, units},
        device::failed,
    },
};
use cubecl::client::ProfileWindow;
use cubecl::prelude::*;
use cubecl::profile::ProfileDuration;
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

/// Rates of the device over arrays that its caches do not hold. Fails with [`GpuError`] if the device fails.
pub(crate) fn probe(gpu: &Gpu) -> Result<Probe, GpuError> {
    let client = &gpu.client;
    let len = STREAM_BYTES.min(gpu.adapter().max_buffer_bytes as usize) / 4;
    let (a, b) = (Buffer::empty(client, len), Buffer::empty(client, len));
    let bytes_per_s = rate(gpu, 12.0 * len as f64, || {
        launch!(client, stream::launch, (cubes(len, 256), units()), [a, b]);
    })?;
    let out = Buffer::empty(client, 256 * CUBES);
    let operations = (256 * CUBES * CHAINS) as f64 * f64::from(ROUNDS);
    let operations_per_s = rate(gpu, operations, || {
        launch!(client, multiply::launch, (cubes(256 * CUBES, 256), units()), [out], [0.5]);
    })?;
    Ok(Probe { bytes_per_s, operations_per_s })
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

/// Wall clock per kernel, in the order of [`Kernel::ALL`]; 0 for those that did not run.
pub type Laps = [Duration; Kernel::ALL.len()];

/// Does nothing until it is started: only benches pay for it.
#[derive(Debug, Default)]
pub struct Stopwatch(Option<Running>);

struct Running {
    window: Option<ProfileWindow>,
    laps: Vec<(Kernel, ProfileDuration)>,
    failure: Option<GpuError>,
}

impl std::fmt::Debug for Running {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Running").field("laps", &self.laps.len()).finish()
    }
}

const DOING: &str = "timing kernels";

impl Stopwatch {
    /// Starts the measurement.
    pub fn start(&mut self, gpu: &Gpu) {
        self.0 = Some(Running::new(gpu));
    }

    /// What was asked for since the last lap is `kernel`'s.
    pub fn lap(&mut self, gpu: &Gpu, kernel: Kernel) {
        if let Some(running) = &mut self.0 {
            running.lap(gpu, kernel);
        }
    }

    /// Waits for all laps, and stops counting; 0 everywhere if it was never started.
    /// Fails with [`GpuError`] if the device cannot be timed.
    pub fn stop(&mut self, gpu: &Gpu) -> Result<Laps, GpuError> {
        let mut out = Laps::default();
        let Some(running) = self.0.take() else {
            return Ok(out);
        };
        if let Some(window) = running.window {
            gpu.client.profile_abandon(window);
        }
        if let Some(failure) = running.failure {
            return Err(failure);
        }
        for (kernel, lap) in running.laps {
            let ticks = cubecl::future::block_on(lap.resolve());
            let ticks = ticks.ok_or_else(|| failed(DOING, &"its clock gave no time"))?;
            for (sum, of) in out.iter_mut().zip(Kernel::ALL) {
                if of == kernel {
                    *sum += ticks.duration();
                }
            }
        }
        Ok(out)
    }
}

impl Running {
    fn new(gpu: &Gpu) -> Self {
        let mut running = Self { window: None, laps: Vec::new(), failure: None };
        running.open(gpu);
        running
    }

    fn open(&mut self, gpu: &Gpu) {
        match gpu.client.profile_start() {
            Ok(window) => self.window = Some(window),
            Err(error) => self.failure = Some(failed(DOING, &error)),
        }
    }

    fn lap(&mut self, gpu: &Gpu, kernel: Kernel) {
        let Some(window) = self.window.take() else { return };
        match gpu.client.profile_end(window) {
            Ok(lap) => self.laps.push((kernel, lap)),
            Err(error) => {
                self.failure = Some(failed(DOING, &error));
                return;
            }
        }
        self.open(gpu);
    }
}
