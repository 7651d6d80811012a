//! Flow at the picture's size: each pixel a weighted mean of nine of the coarse ones (RAFT's convex upsampling).

use crate::ops::{conv, convex_upsample};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::Conv2d;

/// From a quarter of the size to all of it.
const FACTOR: usize = 4;

/// What finds the weights. Named `upsampler.0` and `upsampler.2` in the checkpoint.
#[derive(Module, Debug)]
pub struct Upsampler {
    hidden: Conv2d,
    weights: Conv2d,
}

impl Upsampler {
    pub fn new(width: usize, device: &Device) -> Self {
        Self {
            hidden: conv([2 + width, 256], 3, 1, true, device),
            weights: conv([256, 9 * FACTOR * FACTOR], 1, 1, true, device),
        }
    }

    /// Of `flow` `[h, w, 2]` (pixels of the map) and `features` `[h, w, c]`: the flow `[4 h, 4 w, 2]` in pixels of the picture.
    pub fn forward(&self, features: Tensor<3>, flow: Tensor<3>) -> Tensor<3> {
        let both = Tensor::cat(vec![flow.clone(), features], 2);
        let both = both.permute([2, 0, 1]).unsqueeze::<4>();
        let weights = self.weights.forward(relu(self.hidden.forward(both)));
        convex_upsample(flow, weights.squeeze_dim(0), FACTOR)
    }
}
