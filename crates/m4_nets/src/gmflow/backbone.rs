//! The picture's features at a quarter and an eighth of its size.

use crate::ops::{conv, instance_norm};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::activation::relu;
use burn_core::tensor::module::conv2d;
use burn_core::tensor::ops::ConvOptions;
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::Conv2d;

/// Two convolutions with instance normalisation beside a shortcut.
#[derive(Module, Debug)]
pub struct Residual {
    conv1: Conv2d,
    conv2: Conv2d,
    downsample: Option<Downsample>,
}

/// The shortcut where width or size change. Named `downsample.0` in the checkpoint.
#[derive(Module, Debug)]
pub struct Downsample {
    conv: Conv2d,
}

impl Residual {
    fn new(channels: [usize; 2], stride: usize, device: &Device) -> Self {
        let [from, to] = channels;
        Self {
            conv1: conv([from, to], 3, stride, false, device),
            conv2: conv([to, to], 3, 1, false, device),
            downsample: (stride != 1 || from != to).then(|| Downsample {
                conv: conv([from, to], 1, stride, true, device),
            }),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = relu(instance_norm(self.conv1.forward(x.clone())));
        let y = relu(instance_norm(self.conv2.forward(y)));
        let x = match &self.downsample {
            Some(shortcut) => instance_norm(shortcut.conv.forward(x)),
            None => x,
        };
        relu(x + y)
    }
}

/// One kernel for both sizes.
#[derive(Module, Debug)]
pub struct TridentConv {
    /// `[128, 128, 3, 3]`.
    weight: Param<Tensor<4>>,
}

impl TridentConv {
    fn forward(&self, x: Tensor<4>, stride: usize) -> Tensor<4> {
        let options = ConvOptions::new([stride, stride], [1, 1], [1, 1], 1);
        conv2d(x, self.weight.val(), None, options)
    }
}

/// The encoder (section 3.1 of the paper).
#[derive(Module, Debug)]
pub struct Backbone {
    conv1: Conv2d,
    layer1: [Residual; 2],
    layer2: [Residual; 2],
    layer3: [Residual; 2],
    conv2: Conv2d,
    trident_conv: TridentConv,
}

impl Backbone {
    pub fn new(width: usize, device: &Device) -> Self {
        let layer = |from, to, stride| {
            [
                Residual::new([from, to], stride, device),
                Residual::new([to, to], 1, device),
            ]
        };
        Self {
            conv1: conv([3, 64], 7, 2, false, device),
            layer1: layer(64, 64, 1),
            layer2: layer(64, 96, 2),
            layer3: layer(96, 128, 1),
            conv2: conv([128, width], 1, 1, true, device),
            trident_conv: TridentConv {
                weight: Param::from_tensor(Tensor::zeros([width, width, 3, 3], device)),
            },
        }
    }

    /// Of pictures `[n, 3, h, w]`: features `[n, 128, h / 4, w / 4]` and `[n, 128, h / 8, w / 8]`.
    pub fn forward(&self, x: Tensor<4>) -> (Tensor<4>, Tensor<4>) {
        let mut x = relu(instance_norm(self.conv1.forward(x)));
        for block in [&self.layer1, &self.layer2, &self.layer3].into_iter().flatten() {
            x = block.forward(x);
        }
        let x = self.conv2.forward(x);
        (self.trident_conv.forward(x.clone(), 1), self.trident_conv.forward(x, 2))
    }
}
