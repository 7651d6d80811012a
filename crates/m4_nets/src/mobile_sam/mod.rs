//! MobileSAM: segmentation from a point, a box or an earlier mask.
//!
//! - Papers: Kirillov et al., "Segment Anything", ICCV 2023 (prompt encoder, mask decoder); Zhang et al., "Faster Segment Anything: Towards
//!   Lightweight SAM for Mobile Applications", 2023 (the image encoder, a TinyViT).
//! - Upstream: ChaoningZhang/MobileSAM, Apache-2.0. Weights (Apache-2.0): the entry `mobile-sam` of `minute4d weights list`.
//!
//! ```text
//! image --resize, pad--> 1024 x 1024 --TinyVit--> embedding [256, 64, 64]
//! prompt --PromptEncoder--> tokens, map;  embedding + map, tokens --MaskDecoder--> 4 masks [256, 256], their qualities
//! ```
//!
//! [`MobileSam::encode`] is nearly all of the work and depends on the image alone; any number of prompts may follow. Places are
//! in pixels of the image as everywhere in this library: the centre of its first pixel is (0.5, 0.5).

mod decoder;
mod preprocess;
mod tiny_vit;

pub use crate::sam::{PointPrompt, Prompt};

use crate::ops::tensor;
use crate::sam::{Prompt, PromptEncoder};
use crate::{Compute, LoadError, load};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::{Device, Tensor};
use decoder::MaskDecoder;
use m4_core::{Plane, RgbImage};
use preprocess::{EMBEDDING_SIDE, INPUT_SIDE, MASK_SIDE, Scale};
use std::path::Path;
use tiny_vit::TinyVit;

/// Why there is no mask.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SamError {
    /// An image has no pixels, or is too narrow for its length.
    #[error("masks need an image with pixels on both sides when the longer has 1024, not {width} x {height}")]
    Shape {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The prompt is empty.
    #[error("a prompt needs a point, a box or a mask")]
    NothingAsked,
    /// A point or a corner of the prompt is not in the image.
    #[error("the prompt has a point at column {}, row {} of an image of {width} x {height} pixels", at_px[0], at_px[1])]
    Outside {
        /// Column and row, in pixels.
        at_px: [f32; 2],
        /// Columns of the image.
        width: usize,
        /// Rows of the image.
        height: usize,
    },
    /// The box of the prompt ends before it begins.
    #[error("the box of a prompt must be first column and row, then last column and row, not {0:?}")]
    Reversed([f32; 4]),
    /// The prompt's mask has numbers that are infinite or none.
    #[error("the mask of a prompt has NaN or infinite values")]
    NotFinite,
    /// The prompt's mask has another size.
    #[error("the mask of a prompt has 256 x 256 pixels, as the logits of a prediction, not {width} x {height}")]
    MaskSize {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The device failed, for one for lack of memory.
    #[error("the device that computes masks failed: {0}")]
    Device(String),
}

/// What the network keeps of an image, for any number of prompts.
#[derive(Debug, Clone)]
pub struct Embedding {
    scale: Scale,
    /// `[256, 64, 64]`.
    map: Tensor<3>,
}

impl Embedding {
    /// The numbers, `[256][64][64]`, of the square that the image lies in the upper left of.
    ///
    /// # Errors
    ///
    /// [`SamError::Device`] if the device fails.
    pub fn to_vec(&self) -> Result<Vec<f32>, SamError> {
        numbers(self.map.clone())
    }

    /// A mask of the image, of any size with pixels and the image's shape, as the `mask_logits` of a [`Prompt`].
    #[must_use]
    pub fn mask_logits(&self, mask: &Plane<f32>) -> Plane<f32> {
        self.scale.to_square(mask)
    }
}

/// A mask.
#[derive(Debug, Clone, PartialEq)]
pub struct MaskPrediction {
    scale: Scale,
    /// `[256][256]`, of the square that the image lies in the upper left of, its longer side along a whole side: above 0 where the
    /// object is. May be part of another [`Prompt`].
    pub logits: Plane<f32>,
    /// How well the network thinks that the mask fits: its intersection with the true one over their union, 1 at best (though the
    /// network may say a little more, or less than 0).
    pub iou: f32,
}

impl MaskPrediction {
    /// The logits at the image's size, bilinear: above 0 where the object is.
    #[must_use]
    pub fn image_logits(&self) -> Plane<f32> {
        self.logits_at(self.scale.size())
    }

    /// The same at another size, columns and rows.
    #[must_use]
    pub fn logits_at(&self, size: (usize, usize)) -> Plane<f32> {
        self.scale.to_image(&self.logits, size)
    }
}

/// The network with its weights.
#[derive(Debug)]
pub struct MobileSam {
    net: Net,
    /// Where the pixels of the embedding are, `[64 * 64, 256]`.
    grid: Tensor<2>,
    device: Device,
}

/// Fields as in the checkpoint.
#[derive(Module, Debug)]
struct Net {
    image_encoder: TinyVit,
    prompt_encoder: PromptEncoder,
    mask_decoder: MaskDecoder,
}

/// Names of the checkpoint that are not those of fields.
const RENAMES: [(&str, &str); 15] = [
    (r"\.patch_embed\.seq\.0\.", ".patch_embed.first."),
    (r"\.patch_embed\.seq\.2\.", ".patch_embed.second."),
    (r"^image_encoder\.layers\.([0-3])\.", "image_encoder.stage$1."),
    (r"\.neck\.0\.", ".neck.flat."),
    (r"\.neck\.1\.", ".neck.norm1."),
    (r"\.neck\.2\.", ".neck.wide."),
    (r"\.neck\.3\.", ".neck.norm2."),
    (r"\.mask_downscaling\.0\.", ".mask_downscaling.half."),
    (r"\.mask_downscaling\.1\.", ".mask_downscaling.norm1."),
    (r"\.mask_downscaling\.3\.", ".mask_downscaling.quarter."),
    (r"\.mask_downscaling\.4\.", ".mask_downscaling.norm2."),
    (r"\.mask_downscaling\.6\.", ".mask_downscaling.wide."),
    (r"\.output_upscaling\.0\.", ".output_upscaling.twice."),
    (r"\.output_upscaling\.1\.", ".output_upscaling.norm."),
    (r"\.output_upscaling\.3\.", ".output_upscaling.again."),
];

/// Whether a tensor of the checkpoint is of no use here: TinyViT's head, which names what ImageNet shows, and the counters of batch
/// normalisation, which only training reads.
fn unneeded(name: &str) -> bool {
    const HEAD: [&str; 4] = ["head.weight", "head.bias", "norm_head.weight", "norm_head.bias"];
    let head = name.strip_prefix("image_encoder.").is_some_and(|name| HEAD.contains(&name));
    head || name.ends_with(".bn.num_batches_tracked")
}

impl MobileSam {
    /// The network with the weights of the checkpoint at `path`, on `device`.
    ///
    /// # Errors
    ///
    /// [`LoadError`] if the file cannot be read or holds another network.
    pub fn load(path: &Path, on: impl Into<Compute>) -> Result<Self, LoadError> {
        let on: Compute = on.into();
        let device = &on.device;
        let mut net = Net {
            image_encoder: TinyVit::new(device),
            prompt_encoder: PromptEncoder::new(device),
            mask_decoder: MaskDecoder::new(device),
        };
        load::fill(&mut net, "MobileSAM", path, &RENAMES, unneeded)?;
        Ok(Self { grid: prompt::grid(&net.prompt_encoder, device), net, device: device.clone() })
    }

    /// Numbers of the checkpoint that are used, statistics and waves among them.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.net.num_params()
    }

    /// The embedding of `image`.
    ///
    /// # Errors
    ///
    /// [`SamError::Shape`] if it has no pixels, or its longer side has more than 2048 times the pixels of the other.
    pub fn encode(&self, image: &RgbImage) -> Result<Embedding, SamError> {
        let scale = Scale::of(image.width(), image.height())?;
        let map = self.net.image_encoder.forward(scale.tensor(image, &self.device)?);
        Ok(Embedding { scale, map: map.squeeze_dim(0) })
    }

    /// Four masks of what `prompt` shows in the image of `embedding`. The first is the one to take where there is no doubt which object is
    /// meant; the others are three readings of a prompt that [is ambiguous](Prompt::is_ambiguous): take that of the highest `iou`.
    ///
    /// # Errors
    ///
    /// [`SamError`] if the prompt is empty or wrong, or the device fails.
    pub fn masks(&self, embedding: &Embedding, prompt: &Prompt) -> Result<Vec<MaskPrediction>, SamError> {
        let (tokens, map) = prompt::encoded(&self.net.prompt_encoder, prompt, embedding.scale, &self.device)?;
        let map = embedding.map.clone() + map;
        let (masks, iou) = self.net.mask_decoder.forward(map, &self.grid, tokens);
        let logits: Vec<f32> = numbers(masks)?;
        let iou = numbers(iou)?;
        let masks = logits.chunks_exact(MASK_SIDE * MASK_SIDE).zip(iou);
        Ok(masks
            .map(|(logits, iou)| MaskPrediction {
                scale: embedding.scale,
                logits: Plane::from_fn(MASK_SIDE, MASK_SIDE, |x, y| logits[y * MASK_SIDE + x]),
                iou,
            })
            .collect())
    }
}

fn numbers<const D: usize>(x: Tensor<D>) -> Result<Vec<f32>, SamError> {
    x.try_into_vec_as().map_err(|error| SamError::Device(error.to_string()))
}

/// Whether `prompt` asks for something in an image that lies so.
fn check(prompt: &Prompt, scale: Scale) -> Result<(), SamError> {
    if prompt.points.is_empty() && prompt.box_px.is_none() && prompt.mask_logits.is_none() {
        return Err(SamError::NothingAsked);
    }
    for point in &prompt.points {
        scale.check(point.at_px)?;
    }
    if let Some([x0, y0, x1, y1]) = prompt.box_px {
        scale.check([x0, y0])?;
        scale.check([x1, y1])?;
        if x1 < x0 || y1 < y0 {
            return Err(SamError::Reversed([x0, y0, x1, y1]));
        }
    }
    match &prompt.mask_logits {
        Some(mask) if mask.size() != (MASK_SIDE, MASK_SIDE) => {
            Err(SamError::MaskSize { width: mask.width(), height: mask.height() })
        }
        Some(mask) if !mask.data().iter().all(|x| x.is_finite()) => Err(SamError::NotFinite),
        _ => Ok(()),
    }
}

/// Tokens `[n, 256]` for the points and the box of `prompt`, if it has any, and what is added to the embedding: `[256, 64, 64]`, or
/// `[256, 1, 1]` without a mask.
///
/// # Errors
///
/// [`SamError`] if nothing is asked, a place is not in the image, the box is reversed, or the mask has another size or numbers that
/// are not finite.
pub(crate) fn encoded(
    encoder: &PromptEncoder,
    prompt: &Prompt,
    scale: Scale,
    device: &Device,
) -> Result<(Option<Tensor<2>>, Tensor<3>), SamError> {
    check(prompt, scale)?;
    let mut tokens = Vec::new();
    let token =
        |at_px: [f32; 2], kind: usize| encoder.place(scale.to_input(at_px).map(|x| x / INPUT_SIDE as f32), kind);
    for point in &prompt.points {
        tokens.push(token(point.at_px, usize::from(point.on_object)));
    }
    match prompt.box_px {
        Some([x0, y0, x1, y1]) => tokens.extend([token([x0, y0], 2), token([x1, y1], 3)]),
        // points are never alone
        None if tokens.is_empty() => {}
        None => tokens.push(encoder.nowhere()),
    }
    let tokens = (!tokens.is_empty()).then(|| Tensor::cat(tokens, 0));
    let mask = prompt.mask_logits.as_ref();
    let mask = mask.map(|mask| tensor(mask.data().to_vec(), [1, 1, MASK_SIDE, MASK_SIDE], device));
    Ok((tokens, encoder.mask(mask).squeeze_dim(0)))
}

/// Where the pixels of the embedding are, row by row: `[64 * 64, 256]`.
pub(crate) fn grid(encoder: &PromptEncoder, device: &Device) -> Tensor<2> {
    encoder.grid([EMBEDDING_SIDE, EMBEDDING_SIDE], device)
}
