//! MobileSAM: segmentation from a point, a box or an earlier mask.
//!
//! - Papers: Kirillov et al., "Segment Anything", ICCV 2023 (prompt encoder, mask decoder); Zhang
//!   et al., "Faster Segment Anything: Towards Lightweight SAM for Mobile Applications", 2023 (the
//!   image encoder, a TinyViT).
//! - Upstream: ChaoningZhang/MobileSAM, Apache-2.0. Weights (Apache-2.0): the entry `mobile-sam` of
//!   `minute4d weights list`.
//!
//! ```text
//! image --resize, pad--> 1024 x 1024 --TinyVit--> embedding [256, 64, 64]
//! prompt --PromptEncoder--> tokens, map;  embedding + map, tokens --MaskDecoder--> 4 masks [256, 256], their qualities
//! ```
//!
//! [`MobileSam::encode`] is nearly all of the work and depends on the image alone; any number of
//! prompts may follow. Places are in pixels of the image as everywhere in this library: the centre
//! of its first pixel is (0.5, 0.5).

mod preprocess;
mod tiny_vit;

use crate::error::numbers;
use crate::ops::tensor;
use crate::sam::{MAP_WIDTH, Mlp, Prompt, PromptEncoder, Token, TwoWay, Upscaling};
use crate::{Compute, LoadError, NetError, load, sam};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::{Device, Tensor};
use m4_core::{Plane, RgbImage};
use preprocess::{EMBEDDING_SIDE, INPUT_SIDE, MASK_SIDE, Scale};
use std::path::Path;
use tiny_vit::TinyVit;

/// What the network keeps of an image, for any number of prompts.
#[derive(Debug, Clone)]
pub struct Embedding {
    scale: Scale,
    /// `[256, 64, 64]`.
    map: Tensor<3>,
}

impl Embedding {
    /// A mask of the image, of any size with pixels and the image's shape, as the `mask_logits` of
    /// a [`Prompt`].
    #[must_use]
    pub fn mask_logits(&self, mask: &Plane<f32>) -> Plane<f32> {
        self.scale.to_square(mask)
    }
}

/// A mask.
#[derive(Debug, Clone, PartialEq)]
pub struct MaskPrediction {
    scale: Scale,
    /// `[256][256]`, of the square that the image lies in the upper left of, its longer side along
    /// a whole side: above 0 where the object is. May be part of another [`Prompt`].
    pub logits: Plane<f32>,
    /// How well the network thinks that the mask fits: its intersection with the true one over
    /// their union, 1 at best (though the network may say a little more, or less than 0).
    pub iou: f32,
}

impl MaskPrediction {
    /// The logits for an image of `size`, columns and rows, bilinear: above 0 where the object is.
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

#[derive(Module, Debug)]
struct Net {
    image_encoder: TinyVit,
    prompt_encoder: PromptEncoder,
    mask_decoder: MaskDecoder,
}

/// Names of the checkpoint that are not those of fields, beside [`sam::RENAMES`].
const RENAMES: [(&str, &str); 8] = [
    (r"\.c\.weight$", ".c"),
    (r"\.patch_embed\.seq\.0\.", ".patch_embed.first."),
    (r"\.patch_embed\.seq\.2\.", ".patch_embed.second."),
    (
        r"^image_encoder\.layers\.([0-3])\.",
        "image_encoder.stage$1.",
    ),
    (r"\.neck\.0\.", ".neck.flat."),
    (r"\.neck\.1\.", ".neck.norm1."),
    (r"\.neck\.2\.", ".neck.wide."),
    (r"\.neck\.3\.", ".neck.norm2."),
];

/// Whether a tensor of the checkpoint is of no use here: TinyViT's head, which names what ImageNet
/// shows, and the counters of batch normalisation, which only training reads.
fn unneeded(name: &str) -> bool {
    const HEAD: [&str; 4] = [
        "head.weight",
        "head.bias",
        "norm_head.weight",
        "norm_head.bias",
    ];
    let head = name
        .strip_prefix("image_encoder.")
        .is_some_and(|name| HEAD.contains(&name));
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
        load::fill(
            &mut net,
            "MobileSAM",
            path,
            &[&RENAMES[..], &sam::RENAMES].concat(),
            unneeded,
        )?;
        Ok(Self {
            grid: net.prompt_encoder.grid([EMBEDDING_SIDE; 2], device),
            net,
            device: device.clone(),
        })
    }

    /// The embedding of `image`.
    ///
    /// # Errors
    ///
    /// [`NetError::Input`] if it has no pixels, or its longer side has more than 2048 times the
    /// pixels of the other.
    pub fn encode(&self, image: &RgbImage) -> Result<Embedding, NetError> {
        let scale = Scale::of(image.size())?;
        let map = self
            .net
            .image_encoder
            .forward(scale.tensor(image, &self.device)?);
        Ok(Embedding {
            scale,
            map: map.squeeze_dim(0),
        })
    }

    /// Four masks of what `prompt` shows in the image of `embedding`. The first is the one to take
    /// where there is no doubt which object is meant; the others are three readings of a prompt
    /// that [is ambiguous](Prompt::is_ambiguous): take that of the highest `iou`.
    ///
    /// # Errors
    ///
    /// [`NetError`] if the prompt is empty or wrong, or the device fails.
    pub fn masks(
        &self,
        embedding: &Embedding,
        prompt: &Prompt,
    ) -> Result<Vec<MaskPrediction>, NetError> {
        let (tokens, map) = encoded(
            &self.net.prompt_encoder,
            prompt,
            embedding.scale,
            &self.device,
        )?;
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

/// Tokens `[n, 256]` for the points and the box of `prompt`, if it has any, and what is added to
/// the embedding: `[256, 64, 64]`, or `[256, 1, 1]` without a mask.
fn encoded(
    encoder: &PromptEncoder,
    prompt: &Prompt,
    scale: Scale,
    device: &Device,
) -> Result<(Option<Tensor<2>>, Tensor<3>), NetError> {
    prompt.check(scale.size(), MASK_SIDE)?;
    let token = |at_px: [f32; 2], kind: usize| {
        encoder.place(scale.to_input(at_px).map(|x| x / INPUT_SIDE as f32), kind)
    };
    let points = prompt
        .points
        .iter()
        .map(|point| token(point.at_px, usize::from(point.on_object)));
    let mut tokens: Vec<_> = points.collect();
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

/// Masks of a prompt.
const MASKS: usize = 4;

/// The mask decoder: four masks of an embedding and a prompt, with predicted quality.
#[derive(Module, Debug)]
struct MaskDecoder {
    transformer: TwoWay,
    iou_token: Token,
    mask_tokens: Token,
    output_upscaling: Upscaling,
    output_hypernetworks_mlps: [Mlp; MASKS],
    iou_prediction_head: Mlp,
}

impl MaskDecoder {
    fn new(device: &Device) -> Self {
        Self {
            transformer: TwoWay::new(device),
            iou_token: Token::new(1, device),
            mask_tokens: Token::new(MASKS, device),
            output_upscaling: Upscaling::new(device),
            output_hypernetworks_mlps: std::array::from_fn(|_| Mlp::new(MAP_WIDTH, device)),
            iou_prediction_head: Mlp::new(MASKS, device),
        }
    }

    /// Of an image's embedding with what is known of the mask, `[256, h, w]`, the places of its
    /// pixels, `[h w, 256]`, and the tokens of the prompt, `[n, 256]`: four masks `[4, 4 h, 4 w]`
    /// and their qualities `[4]`.
    fn forward(
        &self,
        map: Tensor<3>,
        grid: &Tensor<2>,
        prompt: Option<Tensor<2>>,
    ) -> (Tensor<3>, Tensor<1>) {
        let [c, h, w] = map.dims();
        let mut tokens = vec![self.iou_token.weight.val(), self.mask_tokens.weight.val()];
        tokens.extend(prompt);
        let pixels = map.reshape([1, c, h * w]).swap_dims(1, 2);
        let tokens = Tensor::cat(tokens, 0).unsqueeze_dim(0);
        let grid = grid.clone().unsqueeze_dim(0);
        let (tokens, pixels) = self.transformer.forward(tokens, pixels, &grid);
        let tokens = tokens.squeeze_dim::<2>(0);
        let map = self
            .output_upscaling
            .forward(pixels.reshape([1, h, w, c]), None);
        let of_masks = self.output_hypernetworks_mlps.iter().enumerate();
        let weights = of_masks.map(|(i, mlp)| mlp.forward(tokens.clone().narrow(0, 1 + i, 1)));
        let masks = Tensor::cat(weights.collect(), 0)
            .matmul(map.reshape([16 * h * w, MAP_WIDTH]).transpose());
        let iou = self.iou_prediction_head.forward(tokens.narrow(0, 0, 1));
        (masks.reshape([MASKS, 4 * h, 4 * w]), iou.squeeze_dim(0))
    }
}
