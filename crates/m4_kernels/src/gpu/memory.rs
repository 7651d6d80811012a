//! What the runtime holds on the device, and what the device can do.

use crate::bench::Probe;
use crate::gpu::{Gpu, GpuError, device::failed};
use cubecl::MemoryScope;
use cubecl::profile::TimingMethod;

/// Memory of the device that is this process's, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeviceMemory {
    /// Of buffers that are in use now.
    pub in_use: u64,
    /// Taken from the driver: buffers, what is kept for those to come, staging. It rarely shrinks, so that it is close
    /// to the most that was ever taken.
    pub reserved: u64,
}

impl Gpu {
    /// What the runtime says that this process holds on the device.
    #[must_use]
    pub fn memory(&self) -> DeviceMemory {
        let usage = self.client.memory_report(MemoryScope::Device).usage();
        DeviceMemory { in_use: usage.bytes_in_use, reserved: usage.bytes_reserved }
    }

    /// Gives what is in no buffer back to the driver, as far as the runtime does.
    ///
    /// # Errors
    ///
    /// [`GpuError::Failed`] if the device failed.
    pub fn give_back(&self) -> Result<(), GpuError> {
        let doing = "giving memory back";
        self.wait(doing)?;
        self.client.memory_cleanup().map_err(|error| failed(doing, &error))
    }

    /// What the device can do at most, measured now, on 256 MB.
    ///
    /// # Errors
    ///
    /// [`GpuError`] if the device failed.
    pub fn probe(&self) -> Result<Probe, GpuError> {
        crate::gpu::probe::probe(self)
    }

    /// Whether kernels are timed by the device's own clock.
    #[must_use]
    pub fn has_own_clock(&self) -> bool {
        self.client.properties().timing_method == TimingMethod::Device
    }
}
