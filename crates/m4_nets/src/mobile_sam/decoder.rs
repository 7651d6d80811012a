//! The mask decoder: four masks of an embedding and a prompt, and how good each is thought to be.

use super::WIDTH;
use super::layers::{channel_norm, over_channels};
use super::prompt::Token;
use super::two_way::TwoWay;
use crate::ops::{gelu, linear};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::{ConvTranspose2d, ConvTranspose2dConfig};
use burn_nn::{Initializer, LayerNorm, Linear};

/// Masks of a prompt.
pub const MASKS: usize = 4;
/// Channels of the map that masks are made of.
const MAP_WIDTH: usize = WIDTH / 8;

/// Three linear layers.
#[derive(Module, Debug)]
pub struct Mlp {
    layers: [Linear; 3],
}

impl Mlp {
    fn new(to: usize, device: &Device) -> Self {
        Self {
            layers: [WIDTH, WIDTH, to].map(|to| linear(WIDTH, to, true, device)),
        }
    }

    fn forward(&self, x: Tensor<2>) -> Tensor<2> {
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
    fn new(device: &Device) -> Self {
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

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let x = gelu(over_channels(&self.norm, self.twice.forward(x)));
        gelu(self.again.forward(x))
    }
}

/// The decoder.
#[derive(Module, Debug)]
pub struct MaskDecoder {
    transformer: TwoWay,
    iou_token: Token,
    mask_tokens: Token,
    output_upscaling: Upscaling,
    output_hypernetworks_mlps: [Mlp; MASKS],
    iou_prediction_head: Mlp,
}

impl MaskDecoder {
    pub fn new(device: &Device) -> Self {
        Self {
            transformer: TwoWay::new(device),
            iou_token: Token::new(1, device),
            mask_tokens: Token::new(MASKS, device),
            output_upscaling: Upscaling::new(device),
            output_hypernetworks_mlps: std::array::from_fn(|_| Mlp::new(MAP_WIDTH, device)),
            iou_prediction_head: Mlp::new(MASKS, device),
        }
    }

    /// Of a picture's embedding with what is known of the mask, `[256, h, w]`, the places of its pixels, `[h w, 256]`, and the
    /// tokens of the prompt, `[n, 256]`: four masks `[4, 4 h, 4 w]` and their qualities `[4]`.
    pub fn forward(&self, map: Tensor<3>, grid: &Tensor<2>, prompt: Option<Tensor<2>>) -> (Tensor<3>, Tensor<1>) {
        let [c, h, w] = map.dims();
        let mut tokens = vec![self.iou_token.weight.val(), self.mask_tokens.weight.val()];
        tokens.extend(prompt);
        let pixels = map.reshape([c, h * w]).transpose();
        let (tokens, pixels) = self.transformer.forward(Tensor::cat(tokens, 0), pixels, grid);
        let map = self.output_upscaling.forward(pixels.transpose().reshape([1, c, h, w]));
        let of_masks = self.output_hypernetworks_mlps.iter().enumerate();
        let weights = of_masks.map(|(i, mlp)| mlp.forward(tokens.clone().narrow(0, 1 + i, 1)));
        let masks = Tensor::cat(weights.collect(), 0).matmul(map.reshape([MAP_WIDTH, 16 * h * w]));
        let iou = self.iou_prediction_head.forward(tokens.narrow(0, 0, 1));
        (masks.reshape([MASKS, 4 * h, 4 * w]), iou.squeeze_dim(0))
    }
}
