//! Features of an image at a quarter of its size: the network of CoTracker3.

use crate::ops::{conv, convolve, instance_norm, interpolated};
use crate::residual::{Norm, Residual};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{DType, Device, Tensor};
use burn_nn::conv::Conv2d;

/// Pixels along a side for one of the features.
pub const STRIDE: usize = 4;
/// Channels of the four stages.
const STAGES: [usize; 4] = [64, 96, 128, 128];

/// The encoder. Named `encoder.backbone` in the checkpoint.
#[derive(Module, Debug)]
pub struct Encoder {
    conv1: Conv2d,
    layer1: [Residual; 2],
    layer2: [Residual; 2],
    layer3: [Residual; 2],
    layer4: [Residual; 2],
    conv2: Conv2d,
    conv3: Conv2d,
}

impl Encoder {
    /// To `width` channels.
    pub fn new(width: usize, device: &Device) -> Self {
        let layer = |from, to, stride| Residual::pair([from, to], stride, Norm::Instance, device);
        let [a, b, c, d] = STAGES;
        Self {
            conv1: conv([3, a], 7, 2, true, device),
            layer1: layer(a, a, 1),
            layer2: layer(a, b, 2),
            layer3: layer(b, c, 2),
            layer4: layer(c, d, 2),
            conv2: conv([a + b + c + d, 2 * width], 3, 1, true, device),
            conv3: conv([2 * width, width], 1, 1, true, device),
        }
    }

    pub fn dtype(&self) -> DType {
        self.conv1.weight.dtype()
    }

    /// Of images `[n, 3, h, w]` from -1 to 1: `[n, width, h / 4, w / 4]`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let [_, _, h, w] = x.dims();
        let mut x = relu(instance_norm(convolve([x], &self.conv1)));
        let stages =
            [&self.layer1, &self.layer2, &self.layer3, &self.layer4].map(|[first, second]| {
                x = second.forward(first.forward(x.clone(), Norm::Instance), Norm::Instance);
                interpolated(x.clone(), [h / STRIDE, w / STRIDE], true)
            });
        let x = relu(instance_norm(convolve(stages, &self.conv2)));
        convolve([x], &self.conv3)
    }
}
