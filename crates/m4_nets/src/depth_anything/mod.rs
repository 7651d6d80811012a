//! Depth-Anything V1: relative depth of one image.
//!
//! - Paper: Yang et al., "Depth Anything: Unleashing the Power of Large-Scale Unlabeled Data", CVPR
//!   2024; the head is that of Ranftl et al., "Vision Transformers for Dense Prediction", ICCV 2021
//!   (DPT).
//! - Upstream: LiheYoung/Depth-Anything, Apache-2.0, weights too.
//!
//! ```text
//! image --bicubic, sides <= 768--> DINOv2 --last four blocks--> 4 maps of patches
//! maps --DPT: 4 levels, fused from coarse to fine--> disparity of the patches' pixels --bilinear--> disparity of the image
//! ```
//!
//! The result is inverse depth up to an unknown factor and offset: larger is nearer, 0 is the
//! furthest that the network can say. Which of the three sizes a checkpoint holds is read off its
//! tensors.
//!
//! Depth-Anything V2 has the same tensors in the same shapes, but taps other blocks: a checkpoint
//! of it cannot be told from one of this network and gives wrong depth here.

mod head;
#[cfg(test)]
mod tests;

use crate::dinov2::{self, BackboneSize, DinoV2, PATCH};
use crate::error::{numbers, refuse};
use crate::ops::{IMAGENET_MEAN, IMAGENET_STD, Kernels, bilinear, image_tensor};
use crate::{Compute, LoadError, NetError, load};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{Device, Tensor};
use head::DepthHead;
use m4_core::{Plane, RgbImage};
use std::path::Path;

const NAME: &str = "Depth-Anything V1";

/// The network with its weights.
#[derive(Debug)]
pub struct DepthAnything {
    net: Net,
    device: Device,
}

#[derive(Module, Debug)]
struct Net {
    pretrained: DinoV2,
    depth_head: DepthHead,
}

impl Net {
    /// Of `size` with `depth` blocks, waiting for its weights.
    fn new(size: BackboneSize, depth: usize, device: &Device) -> Self {
        Self {
            pretrained: DinoV2::with_depth(size, depth, device),
            depth_head: DepthHead::new(size, device),
        }
    }

    /// Of images `[b, 3, 14 h, 14 w]`: what the head says, `[b, 1, 14 h, 14 w]`; below 0 it means
    /// 0.
    fn logits(&self, images: Tensor<4>) -> Tensor<4> {
        let [_, _, height, width] = images.dims();
        let grid = [height / PATCH, width / PATCH];
        let depth = self.pretrained.depth();
        let taps: [usize; 4] = std::array::from_fn(|i| depth - 4 + i);
        let maps = self.pretrained.taps(images, taps);
        self.depth_head.forward(maps, grid)
    }
}

impl DepthAnything {
    /// The network with the weights of the checkpoint at `path`, on `device`.
    ///
    /// # Errors
    ///
    /// [`LoadError`] if the file cannot be read or holds another network.
    pub fn load(path: &Path, on: impl Into<Compute>) -> Result<Self, LoadError> {
        let on: Compute = on.into();
        let shapes = load::shapes(NAME, path, &head::RENAMES)?;
        let size = BackboneSize::in_checkpoint(&shapes, "pretrained.", NAME, path)?;
        let mut net = Net::new(size, size.depth(), &on.device);
        load::fill(&mut net, NAME, path, &head::RENAMES, dinov2::unneeded)?;
        Ok(Self {
            net: on.fit(net),
            device: on.device,
        })
    }

    /// The disparity of `image`, `[height][width]` as the image: relative (a factor and an offset
    /// are unknown), 0 or more, larger where it is nearer.
    ///
    /// # Errors
    ///
    /// [`NetError`] if the image has no pixels or the device fails.
    pub fn disparity(&self, image: &RgbImage) -> Result<Plane<f32>, NetError> {
        let sides = Sides::of(image.size())?;
        let logits = self.net.logits(sides.tensor(image, &self.device));
        Ok(sides.to_image(&numbers(relu(logits))?))
    }
}

/// Pixels that the longer side has at most.
const LONGEST: usize = 768;

/// Sides of an image and of what the network makes of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Sides {
    width: usize,
    height: usize,
}

impl Sides {
    /// Of an image that has pixels.
    fn of((width, height): (usize, usize)) -> Result<Self, NetError> {
        if width == 0 || height == 0 {
            return refuse("disparity needs an image with pixels");
        }
        Ok(Self { width, height })
    }

    /// Width and height that the network works with: those of the image in the same ratio with the
    /// longer at 768, rounded to whole patches (down where that would make more than 768), one
    /// patch at least.
    fn inside(self) -> (usize, usize) {
        let scale = LONGEST as f64 / self.width.max(self.height) as f64;
        let side = |side: usize| {
            let patches = side as f64 * scale / PATCH as f64;
            let near = patches.round_ties_even() as usize;
            let near = if near * PATCH > LONGEST {
                patches.floor() as usize
            } else {
                near
            };
            near.max(1) * PATCH
        };
        (side(self.width), side(self.height))
    }

    /// The image `[1, 3, height, width]` of the sides [`Sides::inside`], normalised.
    fn tensor(self, image: &RgbImage, device: &Device) -> Tensor<4> {
        image_tensor(
            image,
            self.inside(),
            Kernels::cubic,
            [IMAGENET_MEAN, IMAGENET_STD],
            device,
        )
    }

    /// Disparity of the sides [`Sides::inside`] in those of the image.
    fn to_image(self, disparity: &[f32]) -> Plane<f32> {
        let values = bilinear(disparity, self.inside(), (self.width, self.height));
        Plane::from_fn(self.width, self.height, |x, y| values[y * self.width + x])
    }
}
