//! The neck: all stages in 256 channels, the coarsest added to the one before it.

use super::config::Config;
use crate::ops::conv;
use crate::sam::WIDTH;
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::{DType, Device, Tensor};
use burn_nn::conv::Conv2d;

/// A convolution of single pixels.
#[derive(Module, Debug)]
pub struct Lateral {
    conv: Conv2d,
}

/// The neck.
#[derive(Module, Debug)]
pub struct Neck {
    /// From the coarsest stage to the finest.
    convs: [Lateral; 4],
}

/// The image encoder.
#[derive(Module, Debug)]
pub struct ImageEncoder {
    /// Its stages.
    pub trunk: super::hiera::Hiera,
    /// What makes features of them.
    pub neck: Neck,
}

/// A linear layer of pixels: `[from, to]` and `[1, to]`.
#[derive(Debug, Clone)]
pub struct Pointwise {
    weight: Tensor<2>,
    bias: Tensor<2>,
}

impl Pointwise {
    /// Of a convolution whose kernel is one pixel.
    pub fn of(conv: &Conv2d) -> Self {
        let weight = conv.weight.val();
        let [to, from, _, _] = weight.dims();
        let bias = match &conv.bias {
            Some(bias) => bias.val(),
            None => Tensor::zeros([to], (&weight.device(), weight.dtype())),
        };
        Self { weight: weight.reshape([to, from]).transpose(), bias: bias.unsqueeze() }
    }

    /// This one, and `next` after it.
    pub fn then(self, next: &Self) -> Self {
        Self {
            weight: self.weight.matmul(next.weight.clone()),
            bias: self.bias.matmul(next.weight.clone()) + next.bias.clone(),
        }
    }

    /// In another precision.
    pub fn cast(self, dtype: DType) -> Self {
        Self { weight: self.weight.cast(dtype), bias: self.bias.cast(dtype) }
    }

    /// Of `[n, h, w, from]`: `[n, h, w, to]`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let [n, h, w, from] = x.dims();
        let [_, to] = self.weight.dims();
        let x = x.reshape([n * h * w, from]).matmul(self.weight.clone()) + self.bias.clone();
        x.reshape([n, h, w, to])
    }
}

impl Neck {
    pub fn new(config: &Config, device: &Device) -> Self {
        Self {
            convs: std::array::from_fn(|i| Lateral { conv: conv([config.width_of(3 - i), WIDTH], 1, 1, true, device) }),
        }
    }

    /// The layer of a stage, 0 for the finest.
    pub fn of_stage(&self, stage: usize) -> Pointwise {
        Pointwise::of(&self.convs[3 - stage].conv)
    }
}

/// `x` `[n, h, w, c]` with each pixel four times: `[n, 2 h, 2 w, c]`.
pub fn repeated(x: Tensor<4>) -> Tensor<4> {
    let [n, h, w, c] = x.dims();
    x.reshape([n, h, 1, w, 1, c]).expand([n, h, 2, w, 2, c]).reshape([n, 2 * h, 2 * w, c])
}
