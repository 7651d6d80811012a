//! What the GPU versions of the kernels share: devices, memory, sorts, sums, statistics. The
//! kernels are the files `gpu.rs` of the folders beside this one, in CubeCL: one source for Vulkan,
//! Metal, DX12 and CUDA. Splats on the device are in [`crate::splats`], the launches of a frame in
//! [`crate::renderer::gpu`].

pub mod buffer;
#[cfg(feature = "cuda")]
mod cuda;
pub(crate) mod device;
mod error;
mod inputs;
pub mod keys;
pub mod log;
pub mod random;
pub mod scan;
pub mod sort;
pub mod tally;
mod timing;
pub mod vector;

pub use device::{
    Adapter, AdapterKind, Choice, DeviceMemory, Gpu, Runtime, adapters, automatic, best,
    missing_for_cuda,
};
pub use error::GpuError;
pub use timing::{Laps, Stopwatch};
