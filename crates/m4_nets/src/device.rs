//! Where tensors lie.

use burn_core::tensor::Device;

/// The processor: all cores of the thread pool that is current where a network is called.
#[must_use]
pub fn cpu() -> Device {
    Device::flex()
}

/// A GPU by Vulkan, Metal or DX12, as the runtime calls it. One that was not started yet is at its first use.
#[cfg(feature = "gpu")]
#[must_use]
pub fn gpu(device: cubecl::device::WgpuDevice) -> Device {
    Device::from(device)
}

/// A GPU by CUDA: the driver's number.
#[cfg(feature = "cuda")]
#[must_use]
pub fn cuda(ordinal: usize) -> Device {
    Device::cuda(ordinal)
}
