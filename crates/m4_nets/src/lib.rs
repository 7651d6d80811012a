//! Pretrained networks: their layers written in [Burn](https://burn.dev), their weights read from
//! the published checkpoints.
//!
//! ```text
//! checkpoint --load--> network;  frames --network--> flow, masks, perceptual similarity
//! ```
//!
//! One folder a network. Fields carry the names of the checkpoint's keys, so that a loader is a
//! list of what is named otherwise; a key too many, too few or of another shape is an error. A
//! checkpoint is data: nothing in it is executed.
//!
//! Tensors live on a [`Device`] that is chosen when a network is loaded; [`cpu`] is the one that
//! every build has. On it the same input gives the same bits for any number of threads.
//!
//! No weights are part of the repository, and this crate fetches none: `minute4d weights` does.

#![forbid(unsafe_code)]

pub mod depth_anything;
pub mod droid;
pub mod lpips;
pub mod mobile_sam;
pub mod moge;
pub mod raft;
pub mod sam2;
pub mod tapip3d;
pub mod unidepth;

mod correlation;
mod device;
mod dinov2;
mod error;
#[cfg(test)]
mod fixture;
mod load;
mod ops;
mod residual;
mod sam;

pub use burn_core::tensor::Device;
pub use depth_anything::DepthAnything;
#[cfg(feature = "cuda")]
pub use device::cuda;
#[cfg(feature = "gpu")]
pub use device::gpu;
pub use device::{Compute, cpu};
pub use droid::{DroidMemory, DroidNet};
pub use error::{ClipError, ImageReader, NetError};
pub use load::LoadError;
pub use lpips::{Lpips, LpipsImage, LpipsNet, LpipsScore};
pub use mobile_sam::{MaskPrediction, MobileSam};
pub use moge::{MoGe, MoGeMap, MoGeOptions};
pub use raft::Raft;
pub use sam::{PointPrompt, Prompt};
pub use sam2::{Sam2, Sam2Size};
pub use tapip3d::{PointQuery, PointTracks, PosedClip, Tapip3d, Tapip3dOptions};
pub use unidepth::{UniDepth, UniDepthMap};
