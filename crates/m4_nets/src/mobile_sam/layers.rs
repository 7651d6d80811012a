//! Layers that the parts share.

pub use crate::ops::zeros;
pub use crate::sam::{channel_norm, heads, over_channels};

use crate::ops::Statistics;
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::module::conv2d;
use burn_core::tensor::ops::ConvOptions;
use burn_core::tensor::{Device, Tensor};

/// A convolution and a batch normalisation after it, which is of the statistics of training: one convolution.
#[derive(Module, Debug)]
pub struct ConvBn {
    c: Kernel,
    bn: Statistics,
    stride: usize,
    groups: usize,
}

/// A kernel without bias.
#[derive(Module, Debug)]
pub struct Kernel {
    /// `[out, in / groups, k, k]`.
    weight: Param<Tensor<4>>,
}

impl ConvBn {
    /// Of `[from, to]` channels, with a kernel of `size` by `size`, padded by half of that.
    pub fn new([from, to]: [usize; 2], size: usize, stride: usize, device: &Device) -> Self {
        Self::grouped([from, to], size, stride, 1, device)
    }

    /// 3 by 3, each of `width` channels by itself.
    pub fn depthwise(width: usize, stride: usize, device: &Device) -> Self {
        Self::grouped([width, width], 3, stride, width, device)
    }

    fn grouped([from, to]: [usize; 2], size: usize, stride: usize, groups: usize, device: &Device) -> Self {
        Self {
            c: Kernel { weight: zeros([to, from / groups, size, size], device) },
            bn: Statistics::new(to, device),
            stride,
            groups,
        }
    }

    /// Of `[n, from, h, w]`: `[n, to, h / stride, w / stride]`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let (kernel, bias) = self.bn.after(self.c.weight.val(), None);
        let [_, _, size, _] = kernel.dims();
        let pad = [size / 2, size / 2];
        let options = ConvOptions::new([self.stride, self.stride], pad, [1, 1], self.groups);
        conv2d(x, kernel, Some(bias), options)
    }
}
