//! What the GPU versions of the kernels share: devices, memory, sorts, sums, and the launches of a frame. The kernels are the files `gpu.rs` of
//! the folders beside this one, in CubeCL: one source for Vulkan, Metal, DX12 and CUDA.
//!
//! ```text
//! project -> sort by depth -> bin -> sort by tile -> blend -> loss
//! adam <- project backward <- blend backward <- gradient of the loss
//! ```
//!
//! Splats, moments, frames and everything between stay on the device ([`Trainer`]); a step uploads a camera and reads
//! nothing back. There are no floating-point atomics: every tile entry has a slot of its own for its sums, and each
//! splat adds its slots up in order, so that the same seed gives the same bits on the same device. How many entries
//! there are is known on the device alone: buffers are sized by capacity, and a peak that is read now and then says
//! when they must grow.
//!
//! [`Renderer`] draws one view and its gradient and reads them back: for images, and for the tests that compare with
//! the CPU.

mod batch;
mod bench;
pub(crate) mod buffer;
mod colour;
mod compare;
#[cfg(feature = "cuda")]
mod cuda;
mod density;
mod device;
mod error;
mod error_mask;
mod exposure;
pub(crate) mod eye;
pub(crate) mod found;
mod frames;
mod gather;
pub(crate) mod log;
mod morton;
mod plan;
mod probe;
mod renderer;
mod scan;
mod score;
mod sort;
pub(crate) mod splats;
mod step;
mod stopwatch;
mod trainer;
pub(crate) mod vector;
pub(crate) mod work;

pub use bench::{Bench, DeviceMemory, Drawing};
pub use colour::ColourSums;
pub use density::{DensifyStats, DensityRound, GrowRule, PruneRule, SplitSize};
pub use device::{Adapter, AdapterKind, Choice, Gpu, Runtime, adapters, best, missing_for_cuda};
pub use error::GpuError;
pub use found::Found;
pub use gather::DensifyPlan;
pub use plan::{Part, Plan};
pub use renderer::Renderer;
pub use score::{ScoreRange, ScoreSettings, ScoreSums};
pub use step::{Look, StepSettings};
pub use stopwatch::Laps;
pub use trainer::Trainer;
