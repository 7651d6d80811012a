//! Encoders of residual blocks at ever smaller sizes: those of RAFT and DROID-SLAM; CoTracker3's
//! has the same blocks.

use crate::ops::{Statistics, conv, convolve, instance_norm, with_weights};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{DType, Device, Tensor};
use burn_nn::conv::Conv2d;

/// What follows each convolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Norm {
    /// Instance normalisation without weights.
    Instance,
    /// Batch normalisation by the statistics of training.
    Batch,
    /// Nothing.
    None,
}

impl Norm {
    fn statistics(self, width: usize, device: &Device) -> Option<Statistics> {
        (self == Self::Batch).then(|| Statistics::new(width, device))
    }

    /// `conv` of `x`, normalised; `statistics` are those of [`Norm::Batch`].
    pub fn after(self, conv: &Conv2d, statistics: Option<&Statistics>, x: Tensor<4>) -> Tensor<4> {
        match (self, statistics) {
            (Self::Instance, _) => instance_norm(convolve([x], conv)),
            (Self::Batch, Some(statistics)) => {
                let (kernel, bias) =
                    statistics.after(conv.weight.val(), conv.bias.as_ref().map(|b| b.val()));
                convolve([x], &with_weights(conv.clone(), kernel, Some(bias)))
            }
            _ => convolve([x], conv),
        }
    }
}

#[derive(Module, Debug)]
pub struct Residual {
    conv1: Conv2d,
    conv2: Conv2d,
    norm1: Option<Statistics>,
    norm2: Option<Statistics>,
    downsample: Option<Downsample>,
}

/// The shortcut where the size changes. Named `downsample.0` and `downsample.1` in checkpoints;
/// RAFT's holds the latter again as `norm3`.
#[derive(Module, Debug)]
struct Downsample {
    conv: Conv2d,
    norm: Option<Statistics>,
}

impl Residual {
    /// Two blocks, the first from `from` to `to` channels with `stride`.
    pub fn pair([from, to]: [usize; 2], stride: usize, norm: Norm, device: &Device) -> [Self; 2] {
        [([from, to], stride), ([to, to], 1)].map(|(channels, stride)| Self {
            conv1: conv(channels, 3, stride, true, device),
            conv2: conv([to, to], 3, 1, true, device),
            norm1: norm.statistics(to, device),
            norm2: norm.statistics(to, device),
            downsample: (stride != 1).then(|| Downsample {
                conv: conv(channels, 1, stride, true, device),
                norm: norm.statistics(to, device),
            }),
        })
    }

    /// Of `[n, from, h, w]`: `[n, to, h / stride, w / stride]`.
    pub fn forward(&self, x: Tensor<4>, norm: Norm) -> Tensor<4> {
        let y = relu(norm.after(&self.conv1, self.norm1.as_ref(), x.clone()));
        let y = relu(norm.after(&self.conv2, self.norm2.as_ref(), y));
        let x = match &self.downsample {
            Some(shortcut) => norm.after(&shortcut.conv, shortcut.norm.as_ref(), x),
            None => x,
        };
        relu(x + y)
    }
}

/// The encoder of RAFT (section 3.1 of its paper) and of DROID-SLAM.
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
    /// Stages of `widths` channels, then `to` channels.
    pub fn new([a, b, c]: [usize; 3], to: usize, norm: Norm, device: &Device) -> Self {
        Self {
            conv1: conv([3, a], 7, 2, true, device),
            norm1: norm.statistics(a, device),
            layer1: Residual::pair([a, a], 1, norm, device),
            layer2: Residual::pair([a, b], 2, norm, device),
            layer3: Residual::pair([b, c], 2, norm, device),
            conv2: conv([c, to], 1, 1, true, device),
        }
    }

    pub fn dtype(&self) -> DType {
        self.conv1.weight.dtype()
    }

    /// Of images `[n, 3, h, w]`: features `[n, to, h / 8, w / 8]`. `norm` is the one that it was
    /// made with.
    pub fn forward(&self, x: Tensor<4>, norm: Norm) -> Tensor<4> {
        let x = relu(norm.after(&self.conv1, self.norm1.as_ref(), x));
        let blocks = [&self.layer1, &self.layer2, &self.layer3]
            .into_iter()
            .flatten();
        convolve(
            [blocks.fold(x, |x, block| block.forward(x, norm))],
            &self.conv2,
        )
    }
}
