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
#[cfg(test)]
mod tests;

use crate::dinov2::{self, BackboneSize, DinoV2, PATCH};
use crate::ops::{IMAGENET_MEAN, IMAGENET_STD, Kernels, planes, resampled, tensor};
use crate::{Compute, LoadError, load};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{DType, Device, Tensor};
use head::DepthHead;
use m4_core::{Plane, RgbImage};
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

/// Pixels that the longer side has at most.
const LONGEST: usize = 768;

/// Sides of an image and of what the network makes of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Sides {
    width: usize,
    height: usize,
}

impl Sides {
    /// Of an image of `width` by `height`.
    ///
    /// # Errors
    ///
    /// [`DisparityError::Empty`] if it has no pixels.
    pub fn of(width: usize, height: usize) -> Result<Self, DisparityError> {
        if width == 0 || height == 0 {
            return Err(DisparityError::Empty);
        }
        Ok(Self { width, height })
    }

    /// Width and height that the network works with: those of the image in the same ratio with the longer at 768, rounded to whole
    /// patches (down where that would make more than 768), one patch at least.
    pub fn inside(self) -> (usize, usize) {
        let scale = LONGEST as f64 / self.width.max(self.height) as f64;
        let side = |side: usize| {
            let patches = side as f64 * scale / PATCH as f64;
            let near = patches.round_ties_even() as usize;
            let near = if near * PATCH > LONGEST { patches.floor() as usize } else { near };
            near.max(1) * PATCH
        };
        (side(self.width), side(self.height))
    }

    /// The image `[1, 3, height, width]` of the sides [`Sides::inside`], normalised.
    pub fn tensor(self, image: &RgbImage, device: &Device) -> Tensor<4> {
        let (width, height) = self.inside();
        let values = planes(image, IMAGENET_MEAN, IMAGENET_STD);
        let columns = Kernels::cubic(self.width, width);
        let rows = Kernels::cubic(self.height, height);
        let values = resampled(&values, self.width, self.height, &columns, &rows);
        tensor(values, [1, 3, height, width], device)
    }

    /// Disparity of the sides [`Sides::inside`] in those of the image.
    pub fn to_image(self, disparity: &[f32]) -> Plane<f32> {
        let (width, height) = self.inside();
        let columns = Kernels::linear(width, self.width);
        let rows = Kernels::linear(height, self.height);
        let values = resampled(disparity, width, height, &columns, &rows);
        Plane::from_fn(self.width, self.height, |x, y| values[y * self.width + x])
    }
}

#[cfg(test)]
mod tests {
    use super::Sides;

    /// The table of `fixtures/ops/size_rules`: width and height, then those inside.
    #[test]
    fn sides_are_those_of_the_reference() {
        let table = [
            (854, 480, 756, 434),
            (480, 854, 434, 756),
            (1920, 1080, 756, 434),
            (640, 480, 756, 574),
            (1024, 768, 756, 574),
            (512, 512, 756, 756),
            (360, 640, 434, 756),
            (1280, 720, 756, 434),
            (333, 777, 336, 756),
            (500, 375, 756, 574),
        ];
        for (w, h, width, height) in table {
            assert_eq!(Sides::of(w, h).unwrap().inside(), (width, height), "{w} x {h}");
        }
        assert_eq!(Sides::of(100_000, 1).unwrap().inside(), (756, 14));
        assert!(Sides::of(0, 4).is_err());
    }

    /// A constant stays one, and a slope goes to the image's size and keeps its ends.
    #[test]
    fn disparity_is_resized_to_the_image() {
        let sides = Sides::of(300, 200).unwrap();
        let (w, h) = sides.inside();
        let slope: Vec<f32> = (0..w * h).map(|i| (i % w) as f32 + 0.5).collect();
        let back = sides.to_image(&slope);
        assert_eq!(back.size(), (300, 200));
        let want = 150.5 * w as f32 / 300.0;
        assert!((back[(150, 70)] - want).abs() < 1e-3, "{} for {want}", back[(150, 70)]);
    }
}
