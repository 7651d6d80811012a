//! From tokens and pixels to masks.

use super::{WIDTH, channel_norm};
use crate::ops::{gelu, linear};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::{ConvTranspose2d, ConvTranspose2dConfig};
use burn_nn::{Initializer, LayerNorm, Linear};

/// Channels of the map that masks are made of.
pub const MAP_WIDTH: usize = WIDTH / 8;

/// Three linear layers.
#[derive(Module, Debug)]
pub struct Mlp {
    layers: [Linear; 3],
}

impl Mlp {
    pub fn new(to: usize, device: &Device) -> Self {
        Self { layers: [WIDTH, WIDTH, to].map(|to| linear(WIDTH, to, true, device)) }
    }

    /// Of `[n, 256]`: `[n, to]`.
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        let [a, b, c] = &self.layers;
        c.forward(relu(b.forward(relu(a.forward(x)))))
    }
}

/// To four times the embedding's size. Named `0`, `1` and `3` in the checkpoint.
#[derive(Module, Debug)]
pub struct Upscaling {
    twice: ConvTranspose2d,
    norm: LayerNorm,
    again: ConvTranspose2d,
}

impl Upscaling {
    pub fn new(device: &Device) -> Self {
        let doubling = |from, to| -> ConvTranspose2d {
            ConvTranspose2dConfig::new([from, to], [2, 2])
                .with_stride([2, 2])
                .with_initializer(Initializer::Zeros)
                .init(device)
        };
        Self {
            twice: doubling(WIDTH, WIDTH / 4),
            norm: channel_norm(WIDTH / 4, device),
            again: doubling(WIDTH / 4, MAP_WIDTH),
        }
    }

    /// Of `[b, h, w, 256]`: `[b, 4 h, 4 w, 32]`. `fine` are finer maps of the image to be added where sizes are those, `[1, 2 h, 2 w, 64]`
    /// and `[1, 4 h, 4 w, 32]`, or `b` of them.
    pub fn forward(&self, x: Tensor<4>, fine: Option<[Tensor<4>; 2]>) -> Tensor<4> {
        let [half, whole] = fine.map_or([None, None], |fine| fine.map(Some));
        let add = |x: Tensor<4>, fine: Option<Tensor<4>>| match fine {
            Some(fine) => x + fine,
            None => x,
        };
        let x = gelu(self.norm.forward(add(doubled(&self.twice, x), half)));
        gelu(add(doubled(&self.again, x), whole))
    }
}

/// `conv`, whose kernel and steps are 2 by 2, of `x` `[b, h, w, c]`: one matrix product, as its kernels do not overlap.
fn doubled(conv: &ConvTranspose2d, x: Tensor<4>) -> Tensor<4> {
    let weight = conv.weight.val();
    let [c, to, _, _] = weight.dims();
    let [b, h, w, _] = x.dims();
    let weight = weight.permute([0, 2, 3, 1]).reshape([c, 4 * to]);
    let spread = x.reshape([b * h * w, c]).matmul(weight).reshape([b, h, w, 2, 2, to]);
    let x = spread.permute([0, 1, 3, 2, 4, 5]).reshape([b, 2 * h, 2 * w, to]);
    match &conv.bias {
        Some(bias) => x + bias.val().reshape([1, 1, 1, to]),
        None => x,
    }
}
