//! What the GPU versions of the kernels share: devices, memory, sorts, sums, and the launches of a frame. The kernels are the files `gpu.rs` of
//! the folders beside this one, in CubeCL: one source for Vulkan, Metal, DX12 and CUDA.
//!
//! ```text
//! pose -> project -> starts of the tile lists -> entries -> sort of each list -> blend -> loss
//! adam <- pose backward <- project backward <- blend backward <- gradient of the loss
//! ```
//!
//! Splats, moments, frames and everything between stay on the device while it trains; a step uploads a camera, and what says
//! where windows are in time, and reads nothing back. There are no floating-point atomics: every tile entry has a slot of its own for its sums, and each
//! splat adds its slots up in order, so that the same seed gives the same bits on the same device. How many entries
//! there are is known on the device alone: buffers are sized by capacity, and a peak that is read now and then says
//! when they must grow.
//!
//! [`Renderer`] draws one view and its gradient and reads them back: for images, and for the tests that compare with
//! the CPU.

pub mod buffer;
#[cfg(feature = "cuda")]
mod cuda;
pub(crate) mod device;
mod error;
pub mod frames;
mod inputs;
pub mod log;
pub mod morton;
mod plan;
pub mod random;
mod renderer;
pub mod scan;
mod size;
pub mod sort;
pub mod splats;
pub mod tally;
mod timing;
pub mod vector;
pub mod work;

pub use device::{
    Adapter, AdapterKind, Choice, DeviceMemory, Gpu, Runtime, adapters, automatic, best, missing_for_cuda,
};
pub use error::GpuError;
pub use plan::{Part, Plan};
pub use renderer::Renderer;
pub use timing::{Laps, Stopwatch};
