//! Batch normalisation by the statistics of training, which a convolution before it takes in.

use super::zeros;
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{Device, Tensor};

/// Batch normalisation adds this to the variance.
const EPSILON: f32 = 1e-5;

/// What batch normalisation learned, a number per channel each.
#[derive(Module, Debug)]
pub struct Statistics {
    weight: Param<Tensor<1>>,
    bias: Param<Tensor<1>>,
    running_mean: Param<Tensor<1>>,
    running_var: Param<Tensor<1>>,
}

impl Statistics {
    /// Of `width` channels, waiting for its weights.
    pub fn new(width: usize, device: &Device) -> Self {
        Self {
            weight: zeros([width], device),
            bias: zeros([width], device),
            running_mean: zeros([width], device),
            running_var: zeros([width], device),
        }
    }

    /// Of how many channels.
    pub fn width(&self) -> usize {
        let [width] = self.weight.dims();
        width
    }

    /// The convolution `kernel` `[out, in, h, w]` and `bias` followed by this: again a convolution.
    pub fn after(&self, kernel: Tensor<4>, bias: Option<Tensor<1>>) -> (Tensor<4>, Tensor<1>) {
        let scale = self.weight.val() / (self.running_var.val() + EPSILON).sqrt();
        let mean = match bias {
            Some(bias) => self.running_mean.val() - bias,
            None => self.running_mean.val(),
        };
        let bias = self.bias.val() - mean * scale.clone();
        (kernel * scale.reshape([self.width(), 1, 1, 1]), bias)
    }
}
