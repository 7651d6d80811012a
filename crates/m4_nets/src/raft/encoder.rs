//! An image's features at an eighth of its size: the same layers for what is compared and for the context, but for how they are
//! normalised.

use crate::ops::{Statistics, conv, convolve, instance_norm, with_weights};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{DType, Device, Tensor};
use burn_nn::conv::Conv2d;

/// How a network normalises the channels after each convolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Norm {
    /// Each image by its own mean and variance, without weights.
    Instance,
    /// By the statistics of training.
    Batch,
}

impl Norm {
    fn of(self, width: usize, device: &Device) -> Option<Statistics> {
        (self == Self::Batch).then(|| Statistics::new(width, device))
    }
}

/// A convolution and what normalises its output: `statistics`, or without them that output itself.
fn normalised(conv: &Conv2d, statistics: Option<&Statistics>, x: Tensor<4>) -> Tensor<4> {
    let Some(statistics) = statistics else {
        return instance_norm(convolve([x], conv));
    };
    let (kernel, bias) = statistics.after(conv.weight.val(), conv.bias.as_ref().map(|b| b.val()));
    convolve([x], &with_weights(conv.clone(), kernel, Some(bias)))
}

/// Two convolutions beside a shortcut.
#[derive(Module, Debug)]
pub struct Residual {
    conv1: Conv2d,
    conv2: Conv2d,
    norm1: Option<Statistics>,
    norm2: Option<Statistics>,
    downsample: Option<Downsample>,
}

/// The shortcut where width and size change. Named `downsample.0` and `downsample.1` in the checkpoint, which holds the latter
/// again as `norm3`.
#[derive(Module, Debug)]
pub struct Downsample {
    conv: Conv2d,
    norm: Option<Statistics>,
}

impl Residual {
    fn new([from, to]: [usize; 2], norm: Norm, device: &Device) -> Self {
        let stride = if from == to { 1 } else { 2 };
        Self {
            conv1: conv([from, to], 3, stride, true, device),
            conv2: conv([to, to], 3, 1, true, device),
            norm1: norm.of(to, device),
            norm2: norm.of(to, device),
            downsample: (stride != 1)
                .then(|| Downsample { conv: conv([from, to], 1, stride, true, device), norm: norm.of(to, device) }),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = relu(normalised(&self.conv1, self.norm1.as_ref(), x.clone()));
        let y = relu(normalised(&self.conv2, self.norm2.as_ref(), y));
        let x = match &self.downsample {
            Some(shortcut) => normalised(&shortcut.conv, shortcut.norm.as_ref(), x),
            None => x,
        };
        relu(x + y)
    }

    fn statistics(&self) -> usize {
        let shortcut = self.downsample.as_ref().and_then(|d| d.norm.as_ref());
        [self.norm1.as_ref(), self.norm2.as_ref(), shortcut].into_iter().flatten().map(|norm| 2 * norm.width()).sum()
    }
}

/// The encoder (section 3.1 of the paper).
#[derive(Module, Debug)]
pub struct Encoder {
    conv1: Conv2d,
    norm1: Option<Statistics>,
    layer1: [Residual; 2],
    layer2: [Residual; 2],
    layer3: [Residual; 2],
    conv2: Conv2d,
}

impl Encoder {
    /// To `width` channels.
    pub fn new(width: usize, norm: Norm, device: &Device) -> Self {
        let layer = |from, to| [Residual::new([from, to], norm, device), Residual::new([to, to], norm, device)];
        Self {
            conv1: conv([3, 64], 7, 2, true, device),
            norm1: norm.of(64, device),
            layer1: layer(64, 64),
            layer2: layer(64, 96),
            layer3: layer(96, 128),
            conv2: conv([128, width], 1, 1, true, device),
        }
    }

    /// The type of its numbers.
    pub fn dtype(&self) -> DType {
        self.conv1.weight.dtype()
    }

    /// Of images `[n, 3, h, w]`: features `[n, width, h / 8, w / 8]`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let x = relu(normalised(&self.conv1, self.norm1.as_ref(), x));
        let x = self.blocks().fold(x, |x, block| block.forward(x));
        convolve([x], &self.conv2)
    }

    /// How many of its numbers are statistics of the images of training, which were not learned.
    pub fn statistics(&self) -> usize {
        let first = self.norm1.as_ref().map_or(0, |norm| 2 * norm.width());
        first + self.blocks().map(Residual::statistics).sum::<usize>()
    }

    fn blocks(&self) -> impl Iterator<Item = &Residual> {
        [&self.layer1, &self.layer2, &self.layer3].into_iter().flatten()
    }
}
