//! Aggregates the edges of a source frame into an update of its disparities.

use super::WIDTH;
use crate::ops::{conv, convolve};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::{relu, softplus};
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::Conv2d;

/// Side of the block of pixels that a pixel of the grid stands for.
const BLOCK: usize = 8;

/// Damping and upsampling weights of a source frame, from the mean over its edges.
#[derive(Module, Debug)]
pub struct Aggregation {
    conv1: Conv2d,
    conv2: Conv2d,
    eta: Conv2d,
    upmask: Conv2d,
}

impl Aggregation {
    pub fn new(device: &Device) -> Self {
        Self {
            conv1: conv([WIDTH, WIDTH], 3, 1, true, device),
            conv2: conv([WIDTH, WIDTH], 3, 1, true, device),
            eta: conv([WIDTH, 1], 3, 1, true, device),
            upmask: conv([WIDTH, 9 * BLOCK * BLOCK], 1, 1, true, device),
        }
    }

    /// What is averaged over the edges: of hidden states `[n, 128, h, w]` their sum `[1, 128, h, w]`.
    pub fn sum_of(&self, hidden: Tensor<4>) -> Tensor<4> {
        relu(convolve([hidden], &self.conv1)).sum_dim(0)
    }

    /// Of the mean, what the two outputs share.
    pub fn of_mean(&self, mean: Tensor<4>) -> Tensor<4> {
        relu(convolve([mean], &self.conv2))
    }

    /// The damping of the disparities, `[1, 1, h, w]`.
    pub fn eta(&self, shared: Tensor<4>) -> Tensor<4> {
        softplus(convolve([shared], &self.eta), 1.0).mul_scalar(0.01)
    }

    /// Scores of the nine neighbours for each pixel of a block, `[1, 576, h, w]`.
    pub fn upmask(&self, shared: Tensor<4>) -> Tensor<4> {
        convolve([shared], &self.upmask)
    }
}
