//! Draws splats, and takes the gradient of what was drawn: the kernels of a frame one after the
//! other.

mod cpu;
#[cfg(feature = "gpu")]
pub mod gpu;

pub use cpu::{FrameStats, Renderer};
