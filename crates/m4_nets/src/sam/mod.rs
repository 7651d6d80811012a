//! What the generations of "Segment Anything" share: prompts, the transformer between tokens and
//! pixels, masks.

mod decoder;
mod prompt_encoder;

pub use decoder::{Attention, MAP_WIDTH, Mlp, TwoWay, Upscaling};
pub use prompt_encoder::{PromptEncoder, Token};

use crate::NetError;
use crate::error::refuse;
use burn_core::tensor::Tensor;
use burn_core::tensor::ops::PadMode;
use m4_core::Plane;

/// Channels of embeddings and of tokens.
pub const WIDTH: usize = 256;

/// Names of both checkpoints that are not those of fields.
pub const RENAMES: [(&str, &str); 8] = [
    (r"\.mask_downscaling\.0\.", ".mask_downscaling.half."),
    (r"\.mask_downscaling\.1\.", ".mask_downscaling.norm1."),
    (r"\.mask_downscaling\.3\.", ".mask_downscaling.quarter."),
    (r"\.mask_downscaling\.4\.", ".mask_downscaling.norm2."),
    (r"\.mask_downscaling\.6\.", ".mask_downscaling.wide."),
    (r"\.output_upscaling\.0\.", ".output_upscaling.twice."),
    (r"\.output_upscaling\.1\.", ".output_upscaling.norm."),
    (r"\.output_upscaling\.3\.", ".output_upscaling.again."),
];

/// `x` `[n, h, w, c]` cut into windows of `side` by `side`, zeros beyond the map:
/// `[n rows columns, side, side, c]`.
pub fn cut(x: Tensor<4>, side: usize) -> Tensor<4> {
    let [n, h, w, c] = x.dims();
    let [rows, columns] = [h.div_ceil(side), w.div_ceil(side)];
    let x = if rows * side == h && columns * side == w {
        x
    } else {
        let beyond = [
            (0, 0),
            (0, rows * side - h),
            (0, columns * side - w),
            (0, 0),
        ];
        x.pad(beyond, PadMode::Constant(0.0))
    };
    x.reshape([n, rows, side, columns, side, c])
        .swap_dims(2, 3)
        .reshape([n * rows * columns, side, side, c])
}

/// What [`cut`] made of `n` maps, put together to maps of `h` by `w`; what lies beyond is left out.
pub fn joined(windows: Tensor<4>, n: usize, [h, w]: [usize; 2]) -> Tensor<4> {
    let [_, side, _, c] = windows.dims();
    let [rows, columns] = [h.div_ceil(side), w.div_ceil(side)];
    let x = windows
        .reshape([n, rows, columns, side, side, c])
        .swap_dims(2, 3)
        .reshape([n, rows * side, columns * side, c]);
    if rows * side == h && columns * side == w {
        x
    } else {
        x.narrow(1, 0, h).narrow(2, 0, w)
    }
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
    /// A box around it: column and row of the centre of its first pixel, then of its last, as for
    /// points.
    pub box_px: Option<[f32; 4]>,
    /// The `logits` of an earlier [`MaskPrediction`](crate::MaskPrediction) of the same image,
    /// `[256][256]`.
    pub mask_logits: Option<Plane<f32>>,
}

impl Prompt {
    /// Whether several objects may be meant, a part or the whole: at most one point and no box.
    #[must_use]
    pub fn is_ambiguous(&self) -> bool {
        self.points.len() < 2 && self.box_px.is_none()
    }

    /// Fails unless it asks for something within an image of `width` by `height`, and its mask is
    /// of `mask_side` rows and columns of finite numbers.
    pub(crate) fn check(
        &self,
        (width, height): (usize, usize),
        mask_side: usize,
    ) -> Result<(), NetError> {
        if self.points.is_empty() && self.box_px.is_none() && self.mask_logits.is_none() {
            return refuse("a prompt needs a point, a box or a mask");
        }
        let corners = self
            .box_px
            .into_iter()
            .flat_map(|[x0, y0, x1, y1]| [[x0, y0], [x1, y1]]);
        for [x, y] in self.points.iter().map(|point| point.at_px).chain(corners) {
            if !(0.0..=width as f32).contains(&x) || !(0.0..=height as f32).contains(&y) {
                return refuse(format!(
                    "the prompt has a point at column {x}, row {y} of an image of {width} x {height} pixels"
                ));
            }
        }
        if let Some(bounds @ [x0, y0, x1, y1]) = self.box_px
            && (x1 < x0 || y1 < y0)
        {
            return refuse(format!(
                "the box of a prompt must be first column and row, then last column and row, not {bounds:?}"
            ));
        }
        let Some(mask) = &self.mask_logits else {
            return Ok(());
        };
        let (w, h) = mask.size();
        if (w, h) != (mask_side, mask_side) {
            return refuse(format!(
                "the mask of a prompt has {mask_side} x {mask_side} pixels, as the logits of a prediction, not {w} x {h}"
            ));
        }
        if mask.data().iter().all(|x| x.is_finite()) {
            Ok(())
        } else {
            refuse("the mask of a prompt has NaN or infinite values")
        }
    }
}
