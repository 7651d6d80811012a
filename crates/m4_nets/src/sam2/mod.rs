//! SAM 2.1: masks of what a prompt shows in an image, and of the same object in every other frame
//! of a clip.
//!
//! - Paper: Ravi et al., "SAM 2: Segment Anything in Images and Videos", 2024.
//! - Upstream: facebookresearch/sam2, Apache-2.0. Weights (Apache-2.0): the sizes `tiny`, `small`,
//!   `base_plus` and `large` of version 2.1, whose tensors lie under `model` in the published
//!   files.
//!
//! ```text
//! image --squeeze--> 1024 x 1024 --Hiera, neck--> features at 1/16, finer ones at 1/8 and 1/4
//! features + no memory, prompt --MaskDecoder--> masks [256, 256], their qualities, whether the object is there
//! features, memories of other frames --MemoryAttention--> features, no prompt --MaskDecoder--> the object's mask
//! features, mask --MemoryEncoder--> a memory [64 * 64, 64];  the mask's token --> a pointer [256]
//! ```
//!
//! [`Sam2`] is the network, [`VideoPredictor`] follows objects. Places are in pixels of the image
//! as everywhere in this library: the centre of its first pixel is (0.5, 0.5).
//!
//! Inside, maps have their channels last, so that normalisations and linear layers read rows.

mod bank;
#[cfg(test)]
mod clip_tests;
mod config;
mod decoder;
mod hiera;
mod memory;
mod prompts;
mod recall;
#[cfg(test)]
mod tests;
mod video;

pub use bank::ObjectMask;
pub use config::Sam2Size;
pub use video::{Direction, VideoPredictor, VideoSize};

use crate::error::{numbers, refuse};
use crate::ops::{Kernels, linear, patch_conv, sine_positions, tensor, zeros};
use crate::sam::{Mlp, PromptEncoder, WIDTH};
use crate::{Compute, LoadError, NetError, load, sam};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{DType, Device, Tensor};
use burn_nn::Linear;
use burn_nn::conv::Conv2d;
use config::Config;
use decoder::{Decoded, MaskDecoder};
use hiera::{Hiera, ImageEncoder, Neck, PATCH, Pointwise, repeated};
use m4_core::{Plane, RgbImage};
use memory::{MEMORY_WIDTH, MemoryAttention, MemoryEncoder, Rotations};
use recall::Answer;
use std::path::Path;

/// The side of the image that the network was trained with.
const SIDE: usize = 1024;
/// Pixels a side of the image that are one of the features.
const STRIDE: usize = 16;
/// Pixels a side of the image that are one of a mask.
const MASK_STRIDE: usize = 4;
/// Memories that temporal positions are there for: six frames before, and those that were prompted.
const MEMORIES: usize = 7;
/// The logits of an object that is missing.
const ABSENT: f32 = -1024.0;

/// Names of the checkpoint that are not those of fields, beside [`sam::RENAMES`].
const RENAMES: [(&str, &str); 18] = [
    (r"^model\.", ""),
    (r"\.patch_embed\.proj\.", ".patch_embed."),
    (r"\.neck\.convs\.(\d)\.conv\.", ".neck.convs.$1."),
    (r"\.mask_downsampler\.encoder\.", ".mask_downsampler."),
    (r"\.fuser\.layers\.", ".fuser."),
    (
        r"\.transformer\.layers\.(\d)\.mlp\.layers\.0\.",
        ".transformer.layers.$1.mlp.lin1.",
    ),
    (
        r"\.transformer\.layers\.(\d)\.mlp\.layers\.1\.",
        ".transformer.layers.$1.mlp.lin2.",
    ),
    (r"\.mask_downsampler\.0\.", ".mask_downsampler.convs.0."),
    (r"\.mask_downsampler\.3\.", ".mask_downsampler.convs.1."),
    (r"\.mask_downsampler\.6\.", ".mask_downsampler.convs.2."),
    (r"\.mask_downsampler\.9\.", ".mask_downsampler.convs.3."),
    (r"\.mask_downsampler\.1\.", ".mask_downsampler.norms.0."),
    (r"\.mask_downsampler\.4\.", ".mask_downsampler.norms.1."),
    (r"\.mask_downsampler\.7\.", ".mask_downsampler.norms.2."),
    (r"\.mask_downsampler\.10\.", ".mask_downsampler.norms.3."),
    (r"\.mask_downsampler\.12\.", ".mask_downsampler.out."),
    (r"^sam_prompt_encoder\.", "prompt_encoder."),
    (r"^sam_mask_decoder\.", "mask_decoder."),
];

fn renames() -> Vec<(&'static str, &'static str)> {
    [&RENAMES[..], &sam::RENAMES].concat()
}

/// Whether a tensor of the checkpoint is of no use here: the position of no memory, which is for a
/// way of starting that no published size takes.
fn unneeded(name: &str) -> bool {
    name == "no_mem_pos_enc"
}

const NAME: &str = "SAM 2.1";

#[derive(Module, Debug)]
struct Net {
    image_encoder: ImageEncoder,
    prompt_encoder: PromptEncoder,
    mask_decoder: MaskDecoder,
    memory_attention: MemoryAttention,
    memory_encoder: MemoryEncoder,
    obj_ptr_proj: Mlp,
    obj_ptr_tpos_proj: Linear,
    mask_downsample: Conv2d,
    /// `[7, 1, 1, 64]`: for a frame before, two before, up to six, and for prompted frames.
    maskmem_tpos_enc: Param<Tensor<4>>,
    /// `[1, 1, 256]`.
    no_mem_embed: Param<Tensor<3>>,
    /// `[1, 256]`.
    no_obj_ptr: Param<Tensor<2>>,
    /// `[1, 64]`.
    no_obj_embed_spatial: Param<Tensor<2>>,
}

impl Net {
    fn new(config: &Config, device: &Device) -> Self {
        Self {
            image_encoder: ImageEncoder {
                trunk: Hiera::new(config, device),
                neck: Neck::new(config, device),
            },
            prompt_encoder: PromptEncoder::new(device),
            mask_decoder: MaskDecoder::new(device),
            memory_attention: MemoryAttention::new(device),
            memory_encoder: MemoryEncoder::new(device),
            obj_ptr_proj: Mlp::new(WIDTH, device),
            obj_ptr_tpos_proj: linear(WIDTH, MEMORY_WIDTH, true, device),
            mask_downsample: patch_conv([1, 1], MASK_STRIDE, device),
            maskmem_tpos_enc: zeros([MEMORIES, 1, 1, MEMORY_WIDTH], device),
            no_mem_embed: zeros([1, 1, WIDTH], device),
            no_obj_ptr: zeros([1, WIDTH], device),
            no_obj_embed_spatial: zeros([1, MEMORY_WIDTH], device),
        }
    }
}

/// What follows from the parameters, or from the image's side.
#[derive(Debug)]
struct Tables {
    /// Rows and columns of the features.
    grid: usize,
    /// Positions that the trunk adds, `[1, s / 4, s / 4, c]`.
    trunk: Tensor<4>,
    /// Where pixels of the features are, for memory attention, `[1, n, 256]`.
    sine: Tensor<3>,
    /// The same for memories, `[1, n, 64]`.
    memory_sine: Tensor<3>,
    rotations: Rotations,
    /// Where pixels of the features are, for the mask decoder, `[1, n, 256]`.
    places: Tensor<3>,
    /// A row of a mask's numbers as one of the image's, bilinear: `[1, s, s / 4]`, in 32 bits.
    enlarge: Tensor<3>,
}

/// The network with its weights.
#[derive(Debug)]
pub struct Sam2 {
    net: Net,
    /// The neck's layers: of the two finest stages, together with the decoder's, and of the two
    /// coarsest.
    laterals: [Pointwise; 4],
    tables: Tables,
    size: Sam2Size,
    side: usize,
    device: Device,
    dtype: DType,
}

/// What the network makes of an image, for any number of prompts.
#[derive(Debug, Clone)]
struct Features {
    /// `[1, n, 256]`.
    map: Tensor<3>,
    /// `[1, 2 h, 2 w, 64]` and `[1, 4 h, 4 w, 32]`.
    fine: [Tensor<4>; 2],
}

impl Sam2 {
    /// The network with the weights of the checkpoint at `path`, whose size is seen from its
    /// tensors.
    ///
    /// # Errors
    ///
    /// [`LoadError`] if the file cannot be read or holds another network.
    pub fn load(path: &Path, on: impl Into<Compute>) -> Result<Self, LoadError> {
        let on: Compute = on.into();
        let device = on.device.clone();
        // a size that none of ours has is reported against the smallest
        let size = Sam2Size::of(&load::shapes(NAME, path, &renames())?).unwrap_or(Sam2Size::Tiny);
        let mut net = Net::new(&size.config(), &device);
        load::fill(&mut net, NAME, path, &renames(), unneeded)?;
        Ok(Self::of(net, size, SIDE, &on))
    }

    /// What `net`, in 32 bits, is with `on`.
    fn of(net: Net, size: Sam2Size, side: usize, on: &Compute) -> Self {
        let neck = &net.image_encoder.neck;
        let [finest, fine] = net.mask_decoder.fine();
        let laterals = [
            neck.of_stage(0).then(&finest),
            neck.of_stage(1).then(&fine),
            neck.of_stage(2),
            neck.of_stage(3),
        ];
        let dtype = if on.is_half() { DType::F16 } else { DType::F32 };
        let tables = Tables::new(&net, side, &on.device, dtype);
        let net = Net {
            memory_attention: net.memory_attention.arranged(),
            ..net
        };
        // waves of places are too many for 16 bits
        let prompt_encoder = net.prompt_encoder.clone();
        let net = Net {
            prompt_encoder,
            ..on.fit(net)
        };
        Self {
            net,
            laterals: laterals.map(|layer| layer.cast(dtype)),
            tables,
            size,
            side,
            device: on.device.clone(),
            dtype,
        }
    }

    /// The same network for images that are squeezed to `side` by `side` pixels instead of 1024, as
    /// it was trained: faster and coarser where less. All masks and features shrink with it.
    ///
    /// # Errors
    ///
    /// [`NetError::Input`] unless it is a multiple of 32 from 64 to 2048.
    pub fn with_side(self, side: usize) -> Result<Self, NetError> {
        if !(64..=2048).contains(&side) || !side.is_multiple_of(32) {
            return refuse(format!(
                "the side of the image that SAM 2 takes is a multiple of 32 from 64 to 2048, not {side}"
            ));
        }
        let tables = Tables::new(&self.net, side, &self.device, self.dtype);
        Ok(Self {
            tables,
            side,
            ..self
        })
    }

    /// The size that the checkpoint holds.
    #[must_use]
    pub fn size(&self) -> Sam2Size {
        self.size
    }

    /// Rows and columns of the logits of masks: 256, unless [`Self::with_side`] set another side.
    fn mask_side(&self) -> usize {
        self.side / MASK_STRIDE
    }

    /// The features of `image`; fails if it has no pixels.
    fn encode(&self, image: &RgbImage) -> Result<Features, NetError> {
        let input = prompts::squared(image, self.side, &self.device)?.cast(self.dtype);
        let trunk = &self.net.image_encoder.trunk;
        let stages = trunk.forward(input, self.tables.trunk.clone());
        let [s0, s1, map, coarse] = self.level(stages);
        let n = self.tables.grid * self.tables.grid;
        Ok(Features {
            map: (map + repeated(coarse)).reshape([1, n, WIDTH]),
            fine: [s1, s0],
        })
    }

    /// Each stage after its layer.
    fn level(&self, stages: Vec<Tensor<4>>) -> [Tensor<4>; 4] {
        let mut stages = stages
            .into_iter()
            .zip(&self.laterals)
            .map(|(x, layer)| layer.forward(x));
        // a trunk has four stages
        std::array::from_fn(|_| {
            stages
                .next()
                .unwrap_or_else(|| Tensor::zeros([1, 0, 0, WIDTH], &self.device))
        })
    }

    /// What the decoder says of features `[b, n, 256]` and prompts: tokens `[b, k, 256]`, and masks
    /// `[b, 1, 4 h, 4 w]` if any.
    fn decoded(
        &self,
        map: Tensor<3>,
        features: &Features,
        tokens: Tensor<3>,
        masks: Option<Tensor<4>>,
    ) -> Decoded {
        let mask_embedding = self.net.prompt_encoder.mask(masks).cast(self.dtype);
        let [b, c, h, w] = mask_embedding.dims();
        let mask_embedding = mask_embedding.reshape([b, c, h * w]).swap_dims(1, 2);
        let grid = self.tables.grid;
        self.net.mask_decoder.forward(
            map + mask_embedding,
            &self.tables.places,
            tokens.cast(self.dtype),
            features.fine.clone(),
            [grid, grid],
        )
    }

    /// The one mask that is found without prompts in features `[b, n, 256]` that know of `b`
    /// objects.
    fn followed(&self, map: Tensor<3>, features: &Features) -> Result<Vec<Answer>, NetError> {
        let [b, _, _] = map.dims();
        let nowhere = self.net.prompt_encoder.nowhere();
        let tokens = Tensor::cat(vec![nowhere.clone(), nowhere], 0);
        let tokens = tokens.unsqueeze_dim::<3>(0).expand([b, 2, WIDTH]);
        self.answers(self.decoded(map, features, tokens, None), true)
    }

    /// Masks of the image's square from logits `[b, 4 h, 4 w]`: `[b, 1, 16 h, 16 w]`.
    fn enlarged(&self, logits: Tensor<3>) -> Tensor<4> {
        let rows = self.tables.enlarge.clone();
        let columns = rows.clone().swap_dims(1, 2);
        rows.matmul(logits).matmul(columns).unsqueeze_dim(1)
    }

    /// What is remembered of `b` objects of a frame, `[b, n, 64]`: of masks `[b, 1, 16 h, 16 w]`
    /// from 0 to 1, and whether they are there.
    fn remembered(&self, features: &Features, masks: Tensor<4>, presence: &[bool]) -> Tensor<3> {
        let masks = masks.mul_scalar(20.0).sub_scalar(10.0).cast(self.dtype);
        let grid = self.tables.grid;
        let map = features.map.clone().reshape([1, grid, grid, WIDTH]);
        let b = presence.len();
        let memory = self.net.memory_encoder.forward(map, masks);
        let memory = memory.reshape([b, grid * grid, MEMORY_WIDTH]);
        let absent = presence
            .iter()
            .map(|&present| f32::from(u8::from(!present)))
            .collect();
        let absent: Tensor<3> = tensor(absent, [b, 1, 1], &self.device).cast(self.dtype);
        memory + absent * self.net.no_obj_embed_spatial.val().unsqueeze_dim(0)
    }
}

impl Tables {
    fn new(net: &Net, side: usize, device: &Device, dtype: DType) -> Self {
        let grid = side / STRIDE;
        let (n, mask) = (grid * grid, side / MASK_STRIDE);
        let sine = |channels: usize| {
            let positions = sine_positions([grid, grid], channels, device);
            positions.reshape([1, n, channels]).cast(dtype)
        };
        let enlarge = Kernels::linear(mask, side).matrix(mask);
        Self {
            grid,
            trunk: net
                .image_encoder
                .trunk
                .positions([side / PATCH; 2])
                .cast(dtype),
            sine: sine(WIDTH),
            memory_sine: sine(MEMORY_WIDTH),
            rotations: Rotations::new(grid, device, dtype),
            places: net
                .prompt_encoder
                .grid([grid, grid], device)
                .unsqueeze_dim(0)
                .cast(dtype),
            enlarge: tensor(enlarge, [1, side, mask], device),
        }
    }
}

/// A map `[1, h, w]`.
fn plane(x: Tensor<3>) -> Result<Plane<f32>, NetError> {
    let [_, h, w] = x.dims();
    Plane::from_vec(w, h, numbers(x)?).map_err(|error| NetError::Device(error.to_string()))
}
