//! The kernels of a training step on a GPU: GPU versions of those in [`m4_kernels`], written in CubeCL, one source for Vulkan, Metal, DX12
//! and CUDA.
//!
//! ```text
//! project -> sort by depth -> bin -> sort by tile -> blend -> photo
//! adam <- project backward <- blend backward <- photo's gradient
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

#![expect(
    clippy::manual_div_ceil,
    clippy::manual_is_multiple_of,
    clippy::approx_constant,
    clippy::collapsible_if,
    reason = "kernels are expanded: their front end has no such methods, and conditions at compile time stand alone"
)]

mod adam;
mod batch;
mod bench;
mod blend;
mod blend_backward;
mod buffer;
mod colour;
#[cfg(feature = "cuda")]
mod cuda;
mod density;
mod device;
mod error;
mod error_mask;
mod exposure;
mod eye;
mod found;
mod frames;
mod gather;
mod log;
mod loss;
mod morton;
mod photo;
mod pixels;
mod plan;
mod probe;
mod project;
mod reach;
mod renderer;
mod scan;
mod score;
mod shade;
mod slice;
mod sort;
mod splats;
mod step;
mod stopwatch;
mod tile_binning;
mod trainer;
mod vector;

mod work;

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
