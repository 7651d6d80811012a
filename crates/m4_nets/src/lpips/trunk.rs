//! The layers whose features are compared, and how.

use super::LpipsNet;
use crate::ops::{conv, convolve};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::module::max_pool2d;
use burn_core::tensor::ops::MaxPoolOptions;
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::{Conv2d, Conv2dConfig};
use burn_nn::{Initializer, PaddingConfig2d};

/// Added to the length of a feature vector before it is divided by it.
const EPSILON: f32 = 1e-10;

/// The convolutions, numbered as in the checkpoint.
#[derive(Module, Debug)]
pub struct Net {
    convs: Vec<Conv2d>,
    /// What a difference counts in each channel, one per compared layer: `[1, channels, 1, 1]`.
    lins: [Conv2d; 5],
}

/// The layers up to one that is compared.
struct Stage {
    /// Whether the image is made smaller first: the largest of each square of this many pixels per side, every second one.
    pool: Option<usize>,
    /// Which convolutions, each with the negative cut off.
    convs: std::ops::Range<usize>,
}

impl LpipsNet {
    /// Channels before and after, side, stride and padding of the convolutions.
    fn convolutions(self) -> Vec<([usize; 2], [usize; 3])> {
        match self {
            Self::Alex => vec![
                ([3, 64], [11, 4, 2]),
                ([64, 192], [5, 1, 2]),
                ([192, 384], [3, 1, 1]),
                ([384, 256], [3, 1, 1]),
                ([256, 256], [3, 1, 1]),
            ],
            Self::Vgg => {
                let widths = [3, 64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512];
                widths.windows(2).map(|w| ([w[0], w[1]], [3, 1, 1])).collect()
            }
        }
    }

    fn stages(self) -> [Stage; 5] {
        let stage = |pool, convs| Stage { pool, convs };
        match self {
            Self::Alex => {
                [stage(None, 0..1), stage(Some(3), 1..2), stage(Some(3), 2..3), stage(None, 3..4), stage(None, 4..5)]
            }
            Self::Vgg => [
                stage(None, 0..2),
                stage(Some(2), 2..4),
                stage(Some(2), 4..7),
                stage(Some(2), 7..10),
                stage(Some(2), 10..13),
            ],
        }
    }
}

impl Net {
    /// A network that waits for its weights.
    pub fn new(net: LpipsNet, device: &Device) -> Self {
        let convolutions = net.convolutions();
        let compared = net.stages().map(|stage| convolutions[stage.convs.end - 1].0[1]);
        let layer = |&(channels, [side, stride, pad]): &([usize; 2], [usize; 3])| {
            Conv2dConfig::new(channels, [side, side])
                .with_stride([stride, stride])
                .with_padding(PaddingConfig2d::Explicit(pad, pad, pad, pad))
                .with_initializer(Initializer::Zeros)
                .init(device)
        };
        Self {
            convs: convolutions.iter().map(layer).collect(),
            lins: compared.map(|channels| conv([channels, 1], 1, 1, false, device)),
        }
    }

    /// How far apart two images `[1, 3, h, w]` are at each place of each compared layer: `[1, 1, h', w']`. Both go through the
    /// network side by side, so that the features of one layer at most are held.
    pub fn differences(&self, net: LpipsNet, image: Tensor<4>, reference: Tensor<4>) -> [Tensor<4>; 5] {
        let (mut a, mut b) = (image, reference);
        let stages = net.stages();
        std::array::from_fn(|i| {
            a = self.through(&stages[i], a.clone());
            b = self.through(&stages[i], b.clone());
            let apart = (unit(a.clone()) - unit(b.clone())).square();
            (apart * self.lins[i].weight.val()).sum_dim(1)
        })
    }

    fn through(&self, stage: &Stage, x: Tensor<4>) -> Tensor<4> {
        let x = match stage.pool {
            Some(side) => max_pool2d(x, MaxPoolOptions::new([side, side]).with_stride([2, 2])),
            None => x,
        };
        let convs = &self.convs[stage.convs.clone()];
        convs.iter().fold(x, |x, conv| relu(convolve([x], conv)))
    }
}

/// Each place's features, divided by their length.
fn unit(x: Tensor<4>) -> Tensor<4> {
    let length = x.clone().square().sum_dim(1).sqrt();
    x / (length + EPSILON)
}
