//! Prompts as tokens and maps.

use super::WIDTH;
use crate::ops::{fine_norm, gelu, over_channels, patch_conv, tensor, zeros};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{Device, Tensor};
use burn_nn::LayerNorm;
use burn_nn::conv::Conv2d;
use std::f32::consts::TAU;

/// A learned row of numbers.
#[derive(Module, Debug)]
pub struct Token {
    /// `[rows, 256]`.
    pub weight: Param<Tensor<2>>,
}

impl Token {
    pub fn new(rows: usize, device: &Device) -> Self {
        Self {
            weight: zeros([rows, WIDTH], device),
        }
    }
}

/// Where something is, as sines and cosines of 128 fixed waves.
#[derive(Module, Debug)]
struct Waves {
    /// `[2, 128]`: waves an image's side, to the right and down.
    positional_encoding_gaussian_matrix: Param<Tensor<2>>,
}

impl Waves {
    fn new(device: &Device) -> Self {
        Self {
            positional_encoding_gaussian_matrix: zeros([2, WIDTH / 2], device),
        }
    }

    /// Of places `[n, 2]`, columns and rows as parts of the image's side: `[n, 256]`.
    fn forward(&self, places: Tensor<2>) -> Tensor<2> {
        let centred = places.mul_scalar(2.0).sub_scalar(1.0);
        let angles = centred
            .matmul(self.positional_encoding_gaussian_matrix.val())
            .mul_scalar(TAU);
        Tensor::cat(vec![angles.clone().sin(), angles.cos()], 1)
    }
}

/// An earlier mask as a map. Named `0`, `1`, `3`, `4` and `6` in the checkpoint.
#[derive(Module, Debug)]
struct MaskDownscaling {
    half: Conv2d,
    norm1: LayerNorm,
    quarter: Conv2d,
    norm2: LayerNorm,
    wide: Conv2d,
}

impl MaskDownscaling {
    fn new(device: &Device) -> Self {
        Self {
            half: patch_conv([1, 4], 2, device),
            norm1: fine_norm(4, device),
            quarter: patch_conv([4, 16], 2, device),
            norm2: fine_norm(16, device),
            wide: patch_conv([16, WIDTH], 1, device),
        }
    }

    /// Of `[b, 1, 4 h, 4 w]`: `[b, 256, h, w]`.
    fn forward(&self, mask: Tensor<4>) -> Tensor<4> {
        let x = gelu(over_channels(&self.norm1, self.half.forward(mask)));
        let x = gelu(over_channels(&self.norm2, self.quarter.forward(x)));
        self.wide.forward(x)
    }
}

#[derive(Module, Debug)]
pub struct PromptEncoder {
    pe_layer: Waves,
    /// Off the object, on it, the box's first corner, its last.
    point_embeddings: [Token; 4],
    not_a_point_embed: Token,
    mask_downscaling: MaskDownscaling,
    no_mask_embed: Token,
}

impl PromptEncoder {
    pub fn new(device: &Device) -> Self {
        Self {
            pe_layer: Waves::new(device),
            point_embeddings: std::array::from_fn(|_| Token::new(1, device)),
            not_a_point_embed: Token::new(1, device),
            mask_downscaling: MaskDownscaling::new(device),
            no_mask_embed: Token::new(1, device),
        }
    }

    /// The token `[1, 256]` of a place, column and row as parts of the image's side: 0 off the
    /// object, 1 on it, 2 the box's first corner, 3 its last.
    pub fn place(&self, at: [f32; 2], kind: usize) -> Tensor<2> {
        let embedding = self.point_embeddings[kind].weight.val();
        self.pe_layer
            .forward(tensor(at.to_vec(), [1, 2], &embedding.device()))
            + embedding
    }

    /// The token `[1, 256]` of no place.
    pub fn nowhere(&self) -> Tensor<2> {
        self.not_a_point_embed.weight.val()
    }

    /// What masks `[b, 1, 4 h, 4 w]` add to an embedding, `[b, 256, h, w]`; what none adds,
    /// `[1, 256, 1, 1]`.
    pub fn mask(&self, masks: Option<Tensor<4>>) -> Tensor<4> {
        match masks {
            Some(masks) => self.mask_downscaling.forward(masks),
            None => self.no_mask_embed.weight.val().reshape([1, WIDTH, 1, 1]),
        }
    }

    /// Of the centres of the pixels of a map of `h` rows and `w` columns, row by row:
    /// `[h * w, 256]`.
    pub fn grid(&self, [h, w]: [usize; 2], device: &Device) -> Tensor<2> {
        let centre = |i: usize, n: usize| (i as f32 + 0.5) / n as f32;
        let places = (0..h * w).flat_map(|i| [centre(i % w, w), centre(i / w, h)]);
        self.pe_layer
            .forward(tensor(places.collect(), [h * w, 2], device))
    }
}
