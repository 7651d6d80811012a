//! Features of an image at an eighth of its size.

use crate::ops::{conv, convolve, instance_norm};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::Conv2d;

/// What follows each convolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Norm {
    /// Instance normalisation without weights.
    Instance,
    /// Nothing.
    None,
}

impl Norm {
    fn of(self, x: Tensor<4>) -> Tensor<4> {
        match self {
            Self::Instance => instance_norm(x),
            Self::None => x,
        }
    }
}

/// Two convolutions beside a shortcut.
#[derive(Module, Debug)]
pub struct Residual {
    conv1: Conv2d,
    conv2: Conv2d,
    downsample: Option<Downsample>,
}

/// The shortcut where size changes. Named `downsample.0` in the checkpoint.
#[derive(Module, Debug)]
pub struct Downsample {
    conv: Conv2d,
}

impl Residual {
    fn new([from, to]: [usize; 2], stride: usize, device: &Device) -> Self {
        Self {
            conv1: conv([from, to], 3, stride, true, device),
            conv2: conv([to, to], 3, 1, true, device),
            downsample: (stride != 1).then(|| Downsample { conv: conv([from, to], 1, stride, true, device) }),
        }
    }

    fn forward(&self, x: Tensor<4>, norm: Norm) -> Tensor<4> {
        let y = relu(norm.of(convolve([x.clone()], &self.conv1)));
        let y = relu(norm.of(convolve([y], &self.conv2)));
        let x = match &self.downsample {
            Some(shortcut) => norm.of(convolve([x], &shortcut.conv)),
            None => x,
        };
        relu(x + y)
    }
}

/// The encoder that `fnet` (with instance normalisation) and `cnet` (without any) are.
#[derive(Module, Debug)]
pub struct Encoder {
    conv1: Conv2d,
    layer1: [Residual; 2],
    layer2: [Residual; 2],
    layer3: [Residual; 2],
    conv2: Conv2d,
}

impl Encoder {
    pub fn new(width: usize, device: &Device) -> Self {
        let layer = |from, to, stride| [Residual::new([from, to], stride, device), Residual::new([to, to], 1, device)];
        Self {
            conv1: conv([3, 32], 7, 2, true, device),
            layer1: layer(32, 32, 1),
            layer2: layer(32, 64, 2),
            layer3: layer(64, 128, 2),
            conv2: conv([128, width], 1, 1, true, device),
        }
    }

    /// Of images `[n, 3, h, w]`: `[n, width, h / 8, w / 8]`.
    pub fn forward(&self, x: Tensor<4>, norm: Norm) -> Tensor<4> {
        let mut x = relu(norm.of(convolve([x], &self.conv1)));
        for block in [&self.layer1, &self.layer2, &self.layer3].into_iter().flatten() {
            x = block.forward(x, norm);
        }
        convolve([x], &self.conv2)
    }
}
