//! Depth-Anything V1: relative depth of one image.
//!
//! - Paper: Yang et al., "Depth Anything: Unleashing the Power of Large-Scale Unlabeled Data", CVPR 2024; the head is that of Ranftl et
//!   al., "Vision Transformers for Dense Prediction", ICCV 2021 (DPT).
//! - Upstream: LiheYoung/Depth-Anything, Apache-2.0, weights too.
//!
//! ```text
//! image --bicubic, sides <= 768--> DINOv2 --last four blocks--> 4 maps of patches
//! maps --DPT: 4 levels, fused from coarse to fine--> disparity of the patches' pixels --bilinear--> disparity of the image
//! ```
//!
//! The result is inverse depth up to an unknown factor and offset: larger is nearer, 0 is the furthest that the network
//! can say. Which of the three sizes a checkpoint holds is read off its tensors.
//!
//! Depth-Anything V2 has the same tensors in the same shapes, but taps other blocks: a checkpoint of it cannot be told from one of
//! this network and gives wrong depth here.

mod head;
mod preprocess;
#[cfg(test)]
mod tests;

use crate::dinov2::{self, BackboneSize, DinoV2};
use crate::{Compute, LoadError, load};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{DType, Device, Tensor};
use head::DepthHead;
use m4_core::{Plane, RgbImage};
use preprocess::Sides;
use std::path::Path;

/// What it is called in messages.
const NAME: &str = "Depth-Anything V1";

/// Why there is no disparity.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DisparityError {
    /// The image has no pixels.
    #[error("disparity needs an image with pixels")]
    Empty,
    /// The device failed, for one for lack of memory.
    #[error("the device that computes disparity failed: {0}")]
    Device(String),
}

/// The network with its weights.
#[derive(Debug)]
pub struct DepthAnything {
    net: Net,
    size: BackboneSize,
    device: Device,
}

/// Fields as in the checkpoint.
#[derive(Module, Debug)]
struct Net {
    pretrained: DinoV2,
    depth_head: DepthHead,
}

impl Net {
    /// Of `size` with `depth` blocks, waiting for its weights.
    fn new(size: BackboneSize, depth: usize, device: &Device) -> Self {
        Self { pretrained: DinoV2::with_depth(size, depth, device), depth_head: DepthHead::new(size, device) }
    }

    /// Of images `[b, 3, 14 h, 14 w]`: what the head says, `[b, 1, 14 h, 14 w]`; below 0 it means 0.
    fn logits(&self, images: Tensor<4>) -> Tensor<4> {
        let [_, _, height, width] = images.dims();
        let grid = [height / dinov2::PATCH, width / dinov2::PATCH];
        let depth = self.pretrained.depth();
        let taps: [usize; 4] = std::array::from_fn(|i| depth - 4 + i);
        let maps = self.pretrained.taps(images, taps);
        self.depth_head.forward(maps, grid)
    }
}

impl DepthAnything {
    /// The network with the weights of the checkpoint at `path`, on `device`. [`DepthAnything::size`] tells which one it is.
    ///
    /// # Errors
    ///
    /// [`LoadError`] if the file cannot be read or holds another network.
    pub fn load(path: &Path, on: impl Into<Compute>) -> Result<Self, LoadError> {
        let on: Compute = on.into();
        let device = &on.device;
        let shapes = load::shapes(NAME, path, &head::RENAMES)?;
        let size = BackboneSize::in_checkpoint(&shapes, "pretrained.", NAME, path)?;
        let mut net = Net::new(size, size.depth(), device);
        load::fill(&mut net, NAME, path, &head::RENAMES, dinov2::unneeded)?;
        let net = on.fit(net);
        Ok(Self { net, size, device: device.clone() })
    }

    /// The backbone that the checkpoint holds.
    #[must_use]
    pub fn size(&self) -> BackboneSize {
        self.size
    }

    /// Numbers that the network learned, without those that only its training needed.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.net.num_params()
    }

    /// The disparity of `image`, `[height][width]` as the image: relative (a factor and an offset are unknown), 0 or more, larger where it is
    /// nearer.
    ///
    /// # Errors
    ///
    /// [`DisparityError`] if the image has no pixels or the device fails.
    pub fn disparity(&self, image: &RgbImage) -> Result<Plane<f32>, DisparityError> {
        let sides = Sides::of(image.width(), image.height())?;
        let logits = self.net.logits(sides.tensor(image, &self.device));
        let disparity = relu(logits).cast(DType::F32).try_into_vec_as();
        let disparity: Vec<f32> = disparity.map_err(|error| DisparityError::Device(error.to_string()))?;
        Ok(sides.to_image(&disparity))
    }
}
