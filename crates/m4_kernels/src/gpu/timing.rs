//! Times the kernels of a step.

use crate::Kernel;
use crate::gpu::device::failed;
use crate::gpu::{Gpu, GpuError};
use cubecl::client::ProfileWindow;
use cubecl::profile::ProfileDuration;
use std::time::Duration;

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
        f.debug_struct("Running")
            .field("laps", &self.laps.len())
            .finish()
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
        let mut running = Self {
            window: None,
            laps: Vec::new(),
            failure: None,
        };
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
        let Some(window) = self.window.take() else {
            return;
        };
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
