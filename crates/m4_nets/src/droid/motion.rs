//! MegaSaM's motion head: which pixels are static.

use super::WIDTH;
use super::update::Pair;
use crate::ops::{conv, convolve, gelu, sigmoid};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::{Device, Int, Tensor};
use burn_nn::conv::Conv2d;
use burn_nn::{LayerNorm, LayerNormConfig};

/// The head (MegaSaM, section 3.2.1). What the checkpoint has beside it (`conv4`, `norm_4`, `eta`) only training used.
#[derive(Module, Debug)]
pub struct MotionHead {
    conv0: Conv2d,
    conv1: Conv2d,
    conv3: Conv2d,
    conv5: Conv2d,
    norm_0: LayerNorm,
    norm_1: LayerNorm,
    norm_3: LayerNorm,
    norm_5: LayerNorm,
    logits_2: Pair,
}

impl MotionHead {
    pub fn new(device: &Device) -> Self {
        let wide = |from: usize| conv([from, WIDTH], 3, 1, true, device);
        let norm = || LayerNormConfig::new(WIDTH).with_epsilon(1e-6).init(device);
        Self {
            conv0: wide(2 * WIDTH + 2),
            conv1: wide(WIDTH),
            conv3: wide(WIDTH),
            conv5: wide(WIDTH),
            norm_0: norm(),
            norm_1: norm(),
            norm_3: norm(),
            norm_5: norm(),
            logits_2: Pair::new([WIDTH, 1], [3, 3], device),
        }
    }

    /// What edges say on their own: of `hidden` `[n, 128, h, w]` and `weight` `[n, 2, h, w]`, `[n, 128, h, w]`.
    pub fn edges(&self, hidden: Tensor<4>, weight: Tensor<4>) -> Tensor<4> {
        let x = activated(&self.norm_0, self.first(hidden, weight));
        let x = activated(&self.norm_1, convolve([x.clone()], &self.conv1)) + x;
        activated(&self.norm_3, convolve([x.clone()], &self.conv3)) + x
    }

    /// `conv0` of hidden states, their means over the pixels and weights. The means are the same everywhere, so what they add
    /// depends on nothing but which border is near: a convolution of 3 x 3 pixels.
    fn first(&self, hidden: Tensor<4>, weight: Tensor<4>) -> Tensor<4> {
        let [n, c, h, w] = hidden.dims();
        let all = self.conv0.weight.val();
        let mut pixels = self.conv0.clone();
        let part = |from, len| all.clone().narrow(1, from, len);
        pixels.weight = burn::module::Param::from_tensor(Tensor::cat(vec![part(0, c), part(2 * c, 2)], 1));
        let mut means = self.conv0.clone();
        means.weight = burn::module::Param::from_tensor(part(c, c));
        means.bias = None;
        let mean = hidden.clone().mean_dims(&[2, 3]).expand([n, c, 3, 3]);
        let nine = means.forward(mean);
        let device = nine.device();
        let spread = |nine: Tensor<4>, dim: usize, extent: usize| {
            let index = (0..extent).map(|i| {
                if i == 0 {
                    0
                } else if i + 1 == extent {
                    2
                } else {
                    1_i32
                }
            });
            let index = Tensor::<1, Int>::from_data(index.collect::<Vec<_>>().as_slice(), &device);
            nine.select(dim, index)
        };
        convolve([hidden, weight], &pixels) + spread(spread(nine, 2, h), 3, w)
    }

    /// What the edges say together: of the mean over them, `[1, 128, h, w]`.
    pub fn together(&self, mean: Tensor<4>) -> Tensor<4> {
        activated(&self.norm_5, convolve([mean], &self.conv5))
    }

    /// How likely pixels are static, `[n, 1, h, w]` in 0..1, of both.
    pub fn still(&self, edges: Tensor<4>, together: Tensor<4>) -> Tensor<4> {
        sigmoid(self.logits_2.forward(edges + together, gelu))
    }
}

fn activated(norm: &LayerNorm, x: Tensor<4>) -> Tensor<4> {
    gelu(norm.forward(x.permute([0, 2, 3, 1])).permute([0, 3, 1, 2]))
}
