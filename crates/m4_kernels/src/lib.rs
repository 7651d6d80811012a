//! The numeric core: each kernel as a contract, a reference and a SIMD version.
//!
//! One frame flows through the folders in this order, and its gradient flows back:
//!
//! ```text
//! pose -> slice -> project -> shade -> bin -> blend -> loss          adam, score
//! ```
//!
//! | folder | what it does |
//! |---|---|
//! | `slice` | 4D splat to 3D splat at an instant |
//! | `pose` | splats that nodes carry to where they are at an instant; to splats of an instant or on straight lines for exports |
//! | `project` | 3D splat to an ellipse on the image |
//! | `shade` | 4D spherindrical harmonics to colour |
//! | `tile_binning` | ellipses to depth-ordered tile lists |
//! | `blend` | tile lists to an image |
//! | `loss` | L1 + SSIM and its gradient |
//! | `cover` | growth of dynamic splats in front of a background that no other view shows |
//! | `adam` | sparse parameter update |
//! | `score` | time-weighted error per splat |
//!
//! In each folder `mod.rs` is the contract, `reference.rs` the definition (generic over f32 and
//! f64, slow on purpose, the oracle of the tests), `cpu.rs` the SIMD twin that the product runs,
//! and `gpu.rs` the twin in CubeCL (feature `gpu`; its devices, memory, sorts and sums are in
//! `gpu`, splats on a device in `splats`). `ellipse` is the alpha of a splat at a pixel, which
//! binning and blending share; `stage` goes from splats to what tiles are made of, slice, project
//! and shade in one pass. [`Renderer`] strings the CPU twins together, `renderer::gpu` those of the
//! GPU; `plan` says how much memory they take. Lengths are checked when data enters
//! ([`m4_core::Splats`], [`Frame`]); inside, kernels index freely.

#![cfg_attr(
    feature = "gpu",
    expect(
        clippy::manual_div_ceil,
        clippy::manual_is_multiple_of,
        clippy::collapsible_if,
        reason = "kernels are expanded: their front end has no such methods, and conditions at compile time stand alone"
    )
)]

pub mod adam;
pub mod bench;
pub mod blend;
pub mod cover;
pub mod ellipse;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod loss;
#[cfg(feature = "gpu")]
pub mod plan;
pub mod pose;
pub mod project;
pub mod reference;
pub mod renderer;
pub mod score;
pub mod shade;
pub mod slice;
#[cfg(feature = "gpu")]
pub mod splats;
pub mod tile_binning;

mod frame;
mod kernel;
mod order;
mod simd;
mod stage;

pub use frame::{
    CameraGradient, Frame, Gradients, NODE_PARAMETERS, NodeGradients, StepStats, View,
};
pub use kernel::Kernel;
pub use m4_core::{SIMD_ENV, SimdLevel, SimdLevelError};
pub use order::morton_order;
pub use renderer::{FrameStats, Renderer};
