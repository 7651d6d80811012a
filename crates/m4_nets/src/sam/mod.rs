//! What the generations of "Segment Anything" share: prompts, the transformer between tokens and pixels, masks.

mod decoder;
mod prompt_encoder;

pub use decoder::TwoWay;
pub use decoder::{MAP_WIDTH, Mlp, Upscaling};
pub use prompt_encoder::{PromptEncoder, Token};

use burn_core::tensor::activation::softmax;
use burn_core::tensor::{Device, Tensor};
use burn_nn::{LayerNorm, LayerNormConfig};
use m4_core::Plane;

/// Channels of embeddings and of tokens.
pub const WIDTH: usize = 256;

/// A layer normalisation over the `width` channels of each pixel that waits for its weights (epsilon 1e-6).
pub fn channel_norm(width: usize, device: &Device) -> LayerNorm {
    LayerNormConfig::new(width).with_epsilon(1e-6).init(device)
}

/// `norm` over the channels of `x` `[n, c, h, w]`.
pub fn over_channels(norm: &LayerNorm, x: Tensor<4>) -> Tensor<4> {
    norm.forward(x.permute([0, 2, 3, 1])).permute([0, 3, 1, 2])
}

/// `softmax(q k^T / sqrt(c) + bias) v` of every head, `[n, heads, l, c]`; `bias` is `[1, heads, l, l]`.
pub fn heads(q: Tensor<4>, k: Tensor<4>, v: Tensor<4>, bias: Option<Tensor<4>>) -> Tensor<4> {
    let [_, _, _, c] = q.dims();
    let scores = q.mul_scalar(1.0 / (c as f32).sqrt()).matmul(k.swap_dims(2, 3));
    let scores = match bias {
        Some(bias) => scores + bias,
        None => scores,
    };
    softmax(scores, 3).matmul(v)
}

/// A place in an image, and whether it belongs to the object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointPrompt {
    /// Column and row in pixels of the image; the centre of its first pixel is (0.5, 0.5).
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
    /// The `logits` of an earlier [`MaskPrediction`](crate::MaskPrediction) of the same image, `[256][256]`.
    pub mask_logits: Option<Plane<f32>>,
}

impl Prompt {
    /// Whether several objects may be meant, a part or the whole: at most one point and no box.
    #[must_use]
    pub fn is_ambiguous(&self) -> bool {
        self.points.len() < 2 && self.box_px.is_none()
    }
}
