//! What is asked for, and its encoding: points and boxes as tokens, an earlier mask as a map.

use super::layers::{channel_norm, over_channels, zeros};
use super::picture::{EMBEDDING_SIDE, INPUT_SIDE, MASK_SIDE, Scale};
use super::{SamError, WIDTH};
use crate::ops::{gelu, tensor};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::{Conv2d, Conv2dConfig};
use burn_nn::{Initializer, LayerNorm};
use m4_scene::Plane;
use std::f32::consts::TAU;

/// A place in a picture, and whether it belongs to the object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointPrompt {
    /// Column and row in pixels of the picture; the centre of its first pixel is (0.5, 0.5).
    pub at_px: [f32; 2],
    /// Whether the object is there.
    pub on_object: bool,
}

/// What is known of an object; at least one of the three.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Prompt {
    /// Places on the object and off it.
    pub points: Vec<PointPrompt>,
    /// A box around it: column and row of the centre of its first pixel, then of its last, as for points.
    pub box_px: Option<[f32; 4]>,
    /// The `logits` of an earlier [`MaskPrediction`](super::MaskPrediction) of the same picture, `[256][256]`.
    pub mask_logits: Option<Plane<f32>>,
}

impl Prompt {
    /// Whether several objects may be meant, a part or the whole: at most one point and no box.
    #[must_use]
    pub fn is_ambiguous(&self) -> bool {
        self.points.len() < 2 && self.box_px.is_none()
    }

    fn check(&self, scale: Scale) -> Result<(), SamError> {
        if self.points.is_empty() && self.box_px.is_none() && self.mask_logits.is_none() {
            return Err(SamError::NothingAsked);
        }
        for point in &self.points {
            scale.check(point.at_px)?;
        }
        if let Some([x0, y0, x1, y1]) = self.box_px {
            scale.check([x0, y0])?;
            scale.check([x1, y1])?;
            if x1 < x0 || y1 < y0 {
                return Err(SamError::Reversed([x0, y0, x1, y1]));
            }
        }
        match &self.mask_logits {
            Some(mask) if mask.size() != (MASK_SIDE, MASK_SIDE) => Err(SamError::MaskSize {
                width: mask.width(),
                height: mask.height(),
            }),
            Some(mask) if !mask.data().iter().all(|x| x.is_finite()) => Err(SamError::NotFinite),
            _ => Ok(()),
        }
    }
}

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
pub struct Waves {
    /// `[2, 128]`: waves a picture's side, to the right and down.
    positional_encoding_gaussian_matrix: Param<Tensor<2>>,
}

impl Waves {
    /// Of places `[n, 2]`, columns and rows as parts of the picture's side: `[n, 256]`.
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
pub struct MaskDownscaling {
    half: Conv2d,
    norm1: LayerNorm,
    quarter: Conv2d,
    norm2: LayerNorm,
    wide: Conv2d,
}

impl MaskDownscaling {
    fn new(device: &Device) -> Self {
        let conv = |channels, side: usize| -> Conv2d {
            Conv2dConfig::new(channels, [side, side])
                .with_stride([side, side])
                .with_initializer(Initializer::Zeros)
                .init(device)
        };
        Self {
            half: conv([1, 4], 2),
            norm1: channel_norm(4, device),
            quarter: conv([4, 16], 2),
            norm2: channel_norm(16, device),
            wide: conv([16, WIDTH], 1),
        }
    }

    fn forward(&self, mask: Tensor<4>) -> Tensor<4> {
        let x = gelu(over_channels(&self.norm1, self.half.forward(mask)));
        let x = gelu(over_channels(&self.norm2, self.quarter.forward(x)));
        self.wide.forward(x)
    }
}

/// The prompt encoder.
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
            pe_layer: Waves {
                positional_encoding_gaussian_matrix: zeros([2, WIDTH / 2], device),
            },
            point_embeddings: std::array::from_fn(|_| Token::new(1, device)),
            not_a_point_embed: Token::new(1, device),
            mask_downscaling: MaskDownscaling::new(device),
            no_mask_embed: Token::new(1, device),
        }
    }

    /// Tokens `[n, 256]` for the points and the box of `prompt`, if it has any, and what is added to the embedding: `[256, 64, 64]`,
    /// or `[256, 1, 1]` without a mask.
    ///
    /// # Errors
    ///
    /// [`SamError`] if nothing is asked, a place is not in the picture, the box is reversed, or the mask has another size or numbers
    /// that are not finite.
    pub fn forward(
        &self,
        prompt: &Prompt,
        scale: Scale,
        device: &Device,
    ) -> Result<(Option<Tensor<2>>, Tensor<3>), SamError> {
        prompt.check(scale)?;
        let mut tokens = Vec::new();
        let token = |at_px: [f32; 2], kind: usize| {
            let at = scale.to_input(at_px).map(|x| x / INPUT_SIDE as f32);
            self.pe_layer.forward(tensor(at.to_vec(), [1, 2], device)) + self.point_embeddings[kind].weight.val()
        };
        for point in &prompt.points {
            tokens.push(token(point.at_px, usize::from(point.on_object)));
        }
        match prompt.box_px {
            Some([x0, y0, x1, y1]) => tokens.extend([token([x0, y0], 2), token([x1, y1], 3)]),
            // points are never alone
            None if tokens.is_empty() => {}
            None => tokens.push(self.not_a_point_embed.weight.val()),
        }
        let tokens = (!tokens.is_empty()).then(|| Tensor::cat(tokens, 0));
        let map = match &prompt.mask_logits {
            Some(mask) => {
                let mask = tensor(mask.data().to_vec(), [1, 1, MASK_SIDE, MASK_SIDE], device);
                self.mask_downscaling.forward(mask).squeeze_dim::<3>(0)
            }
            None => self.no_mask_embed.weight.val().reshape([WIDTH, 1, 1]),
        };
        Ok((tokens, map))
    }

    /// Where the pixels of the embedding are, row by row: `[64 * 64, 256]`.
    pub fn grid(&self, device: &Device) -> Tensor<2> {
        let side = EMBEDDING_SIDE;
        let centre = |i: usize| (i as f32 + 0.5) / side as f32;
        let places = (0..side * side).flat_map(|i| [centre(i % side), centre(i / side)]);
        self.pe_layer
            .forward(tensor(places.collect(), [side * side, 2], device))
    }
}
