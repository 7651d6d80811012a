//! `UniDepth` V2, as first published: metric depth and the camera of one image.
//!
//! - Paper: Piccinelli et al., "UniDepthV2: Universal Monocular Metric Depth Estimation Made
//!   Simpler", 2025, after "UniDepth", CVPR 2024. This is the network before that paper, of mid
//!   2024: revision `1d0d3c52` of its weights, which `MegaSaM` uses (the entry `unidepth-v2-l` of
//!   `minute4d weights list`).
//! - Upstream: lpiccinelli-eth/UniDepth, code and weights CC BY-NC 4.0: the weights are for
//!   non-commercial use alone. What is computed here was learned from upstream's code; none of that
//!   code is here.
//!
//! ```text
//! image --2400 patches of its shape--> DINOv2 --last four blocks--> 4 levels of tokens, class tokens
//! class tokens, tokens --camera head--> fx fy cx cy --> rays of the pixels
//! class tokens, tokens, rays --global head--> scale, offset
//! tokens, rays --depth head: 1/14, 1/7, 2/7, 4/7 of the size--> logarithm of depth, normalised over the image
//! depth = softplus((exp(logarithm) + offset) scale)
//! ```
//!
//! Sizes (the backbone's, the number of its blocks, the width of the heads) are read off the
//! checkpoint's tensors. Maps are tokens `[h w, channels]`, row by row. Confidence, which the
//! checkpoint can also give, is not computed.

mod heads;
mod image;
mod layers;
#[cfg(test)]
mod tests;

use crate::dinov2::{self, BackboneSize, DinoV2};
use crate::error::numbers;
use crate::load::{self, Shapes};
use crate::ops::{gelu, linear, norm, sine_positions, zeros};
use crate::{Compute, LoadError, NetError};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{Device, Tensor};
use burn_nn::{LayerNorm, Linear};
use heads::{CameraHead, DecoderInputs, DepthHead, GlobalHead};
use image::{Patches, Rays};
use layers::Adapters;
use m4_core::{Intrinsics, Plane, RgbImage};
use std::path::Path;

const NAME: &str = "UniDepth V2";
/// Patches that an image is cut into where nothing else is asked for: the most that upstream takes.
const PATCHES: usize = 2400;
/// Blocks of the backbone that are tapped: the last ones.
const TAPS: usize = 4;
/// The width of the heads is a multiple of this: eight heads, three times halved, a quarter of
/// which is shuffled into pixels.
const WIDTH_MULTIPLE: usize = 32;

/// Depth and camera of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct UniDepthMap {
    /// `[height][width]` of the image: z-depth in metres.
    pub depth_m: Plane<f32>,
    /// In pixels of the image. The principal point is predicted too.
    pub camera: Intrinsics,
}

/// The network with its weights.
#[derive(Debug)]
pub struct UniDepth {
    net: Net,
    device: Device,
}

#[derive(Module, Debug)]
struct Net {
    pixel_encoder: DinoV2,
    pixel_decoder: Decoder,
}

#[derive(Module, Debug)]
struct Decoder {
    /// `[4, c]`.
    level_embeds: Param<Tensor<2>>,
    camera_layer: CameraHead,
    global_layer: GlobalHead,
    input_adapter: Adapters,
    camera_token_adapter: Adapters,
    global_token_adapter: Adapters,
    depth_layer: DepthHead,
    level_embed_layer: LevelLayer,
}

/// Named `0`, `2` and `3` in the checkpoint.
#[derive(Module, Debug)]
struct LevelLayer {
    expand: Linear,
    contract: Linear,
    norm: LayerNorm,
}

/// Names of the checkpoint that are not those of fields.
const RENAMES: [(&str, &str); 10] = [
    (r"^module\.", ""),
    (
        r"\.input_adapters\.(\d+)\.0\.",
        ".input_adapters.${1}.norm.",
    ),
    (
        r"\.input_adapters\.(\d+)\.1\.",
        ".input_adapters.${1}.linear.",
    ),
    (r"\.process_layers\.0\.", ".process_layers."),
    (r"\.up\.1\.", ".up_depthwise."),
    (r"\.up\.3\.", ".up_conv."),
    (r"\.residual\.0\.", ".residual."),
    (r"\.level_embed_layer\.0\.", ".level_embed_layer.expand."),
    (r"\.level_embed_layer\.2\.", ".level_embed_layer.contract."),
    (r"\.level_embed_layer\.3\.", ".level_embed_layer.norm."),
];

/// Tokens of the backbone's training, and what gives confidence.
fn unneeded(name: &str) -> bool {
    let confidence = ["confidence_mlp.", "to_confidence."]
        .iter()
        .any(|part| name.starts_with(&format!("pixel_decoder.depth_layer.{part}")));
    dinov2::unneeded(name) || name == "pixel_encoder.register_tokens" || confidence
}

/// What the heads give of one image.
#[derive(Debug)]
struct Heads {
    camera: Intrinsics,
    log_scale: f64,
    offset: f64,
    /// `[1, 1, 14 h, 14 w]`.
    logarithms: Tensor<4>,
}

impl Net {
    /// With `depth` blocks and heads of `width` channels, waiting for its weights.
    fn new(size: BackboneSize, depth: usize, width: usize, device: &Device) -> Self {
        let adapters = |n| Adapters::new(n, size.width(), width, device);
        Self {
            pixel_encoder: DinoV2::with_depth(size, depth, device).with_plain_positions(),
            pixel_decoder: Decoder {
                level_embeds: zeros([TAPS, width], device),
                camera_layer: CameraHead::new(width, device),
                global_layer: GlobalHead::new(width, device),
                input_adapter: adapters(TAPS),
                camera_token_adapter: adapters(TAPS),
                global_token_adapter: adapters(2),
                depth_layer: DepthHead::new(width, device),
                level_embed_layer: LevelLayer {
                    expand: linear(width, width, true, device),
                    contract: linear(width, width, true, device),
                    norm: norm(width, device),
                },
            },
        }
    }

    /// Of an image `[1, 3, 14 h, 14 w]`.
    fn heads(&self, image: Tensor<4>, patches: Patches) -> Result<Heads, NetError> {
        let decoder = &self.pixel_decoder;
        let dtype = decoder.level_embeds.dtype();
        let device = image.device();
        let blocks = self.pixel_encoder.depth();
        let taps = self.pixel_encoder.taps(
            image.cast(dtype),
            std::array::from_fn::<_, TAPS, _>(|i| blocks - TAPS + i),
        );
        let levels = taps
            .iter()
            .map(|tap| tap.patches.clone().squeeze_dim(0))
            .collect();
        let levels = decoder.input_adapter.forward(levels);
        let classes = |of: &[usize]| of.iter().map(|&i| taps[i].class.clone()).collect();

        let positions = decoder.positions(patches.grid, &device);
        let camera_tokens = decoder.camera_token_adapter.forward(classes(&[1, 2, 3, 2]));
        let camera = decoder.camera_layer.forward(
            Tensor::cat(levels.clone(), 0),
            positions.clone(),
            Tensor::cat(camera_tokens, 0),
        );
        let camera = patches.camera(few(camera)?);
        let rays = Rays::of(&camera);

        let [h, w] = patches.grid;
        let global_tokens = decoder.global_token_adapter.forward(classes(&[2, 3]));
        let global = decoder.global_layer.forward(
            &levels,
            Tensor::cat(global_tokens, 0),
            rays.encoded(h, w, &device).cast(dtype),
        );
        let [log_scale, offset] = few(global)?;
        let logarithms = decoder.depth_layer.forward(&DecoderInputs {
            levels: &levels,
            positions,
            rays: &rays,
            grid: patches.grid,
        });
        Ok(Heads {
            camera,
            log_scale,
            offset,
            logarithms,
        })
    }
}

impl Decoder {
    /// Of the tokens of all levels, level by level: `[4 h w, c]`, where in the image and on which
    /// level they are.
    fn positions(&self, grid: [usize; 2], device: &Device) -> Tensor<2> {
        let [levels, c] = self.level_embeds.dims();
        let n = grid[0] * grid[1];
        let layer = &self.level_embed_layer;
        let level = layer
            .contract
            .forward(gelu(layer.expand.forward(self.level_embeds.val())));
        let level: Tensor<3> = layer.norm.forward(level).reshape([levels, 1, c]);
        let place = sine_positions(grid, c, device)
            .cast(level.dtype())
            .reshape([1, n, c]);
        (place + level).reshape([levels * n, c])
    }
}

/// `N` numbers `[N, 1]` off the device.
fn few<const N: usize>(x: Tensor<2>) -> Result<[f64; N], NetError> {
    let array = <[f32; N]>::try_from(numbers(x)?);
    let array = array
        .map_err(|values| NetError::Device(format!("gave {} numbers for {N}", values.len())))?;
    Ok(array.map(f64::from))
}

impl UniDepth {
    /// The network with the weights of the checkpoint at `path`, on `device`.
    ///
    /// # Errors
    ///
    /// [`LoadError`] if the file cannot be read or holds another network.
    pub fn load(path: &Path, on: impl Into<Compute>) -> Result<Self, LoadError> {
        let on: Compute = on.into();
        let device = &on.device;
        let shapes = load::shapes(NAME, path, &RENAMES)?;
        let size = BackboneSize::in_checkpoint(&shapes, "pixel_encoder.", NAME, path)?;
        let (depth, width) = sizes(&shapes, path)?;
        let mut net = Net::new(size, depth, width, device);
        load::fill(&mut net, NAME, path, &RENAMES, unneeded)?;
        let net = on.fit(net);
        Ok(Self {
            net,
            device: device.clone(),
        })
    }

    /// Depth and camera of `image`, by 2400 patches.
    ///
    /// # Errors
    ///
    /// [`NetError`] if the image has no pixels or is too narrow, or the device fails.
    pub fn depth(&self, image: &RgbImage) -> Result<UniDepthMap, NetError> {
        self.depth_by_patches(image, PATCHES)
    }

    /// The same by about `patches` of 14 by 14 pixels: fewer are faster and coarser. Upstream takes
    /// 1400 to 2400.
    ///
    /// # Errors
    ///
    /// As [`UniDepth::depth`].
    pub fn depth_by_patches(
        &self,
        image: &RgbImage,
        patches: usize,
    ) -> Result<UniDepthMap, NetError> {
        let patches = Patches::of(image.size(), patches)?;
        let heads = self
            .net
            .heads(patches.tensor(image, &self.device), patches)?;
        let logarithms = numbers(heads.logarithms)?;
        Ok(UniDepthMap {
            depth_m: patches.depth(&logarithms, heads.log_scale, heads.offset),
            camera: patches.camera_of_image(&heads.camera),
        })
    }
}

/// Blocks of the backbone and width of the heads in a checkpoint with tensors of `shapes`; fails
/// unless both can be.
fn sizes(shapes: &Shapes, path: &Path) -> Result<(usize, usize), LoadError> {
    let block = |name: &str| -> Option<usize> {
        let rest = name.strip_prefix("pixel_encoder.blocks.")?;
        rest.split('.').next()?.parse().ok()
    };
    let last = shapes.keys().filter_map(|name| block(name)).max();
    let depth = last
        .map_or(0, |last| last.saturating_add(1))
        .min(shapes.len());
    let other = |missing: &[&str], wrong: &[String]| LoadError::misfit(NAME, path, missing, wrong);
    if depth < TAPS {
        return Err(other(&["pixel_encoder.blocks.3.norm1.weight"], &[]));
    }
    let name = "pixel_decoder.level_embeds";
    match shapes.get(name).map(Vec::as_slice) {
        None => Err(other(&[name], &[])),
        Some(&[TAPS, width]) if width > 0 && width.is_multiple_of(WIDTH_MULTIPLE) => {
            Ok((depth, width))
        }
        Some(shape) => {
            let wrong = format!(
                "{name} has the shape {shape:?}, [{TAPS}, a multiple of {WIDTH_MULTIPLE}] is needed"
            );
            Err(other(&[], &[wrong]))
        }
    }
}
