//! The device and precision of tensors.

use burn_core::module::{Module, ModuleMapper, Param};
use burn_core::tensor::{DType, Device, FloatDType, Tensor};

/// The processor: all cores of the thread pool that is current where a network is called.
#[must_use]
pub fn cpu() -> Device {
    Device::flex()
}

/// A GPU by Vulkan, Metal or DX12, as the runtime calls it. One that was not started yet is at its
/// first use.
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

/// Where a network computes, and in which precision. A [`Device`] alone stands for 32 bits.
#[derive(Debug, Clone)]
pub struct Compute {
    /// The device.
    pub device: Device,
    half: bool,
}

impl Compute {
    /// In 16 bits where the device has them, as the published programs do; the processor stays at
    /// 32. LPIPS and MobileSAM stay at 32 bits everywhere.
    #[must_use]
    pub fn half(device: Device) -> Self {
        let half = device != cpu() && device.supports_dtype(FloatDType::F16);
        Self { device, half }
    }

    /// True for 16 bits.
    #[must_use]
    pub fn is_half(&self) -> bool {
        self.half
    }

    /// `module` in this precision.
    pub(crate) fn fit<M: Module>(&self, module: M) -> M {
        if self.half { halved(module) } else { module }
    }
}

impl From<Device> for Compute {
    fn from(device: Device) -> Self {
        Self {
            device,
            half: false,
        }
    }
}

impl From<&Device> for Compute {
    fn from(device: &Device) -> Self {
        device.clone().into()
    }
}

impl From<&Self> for Compute {
    fn from(compute: &Self) -> Self {
        compute.clone()
    }
}

/// `module` with all its numbers in 16 bits.
pub(crate) fn halved<M: Module>(module: M) -> M {
    struct Halves;
    impl ModuleMapper for Halves {
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            param.map(|x| x.cast(DType::F16))
        }
    }
    module.map(&mut Halves)
}
