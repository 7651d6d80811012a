//! The heads: the camera, and scale and offset of depth, from class tokens; the logarithm of depth
//! up to these, from all tokens.

use super::image::{CHANNELS, Rays};
use super::layers::{Block, Mlp};
use crate::ops::{ConvNext, conv, depthwise7, interpolated, linear, norm, zeros};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::activation::relu;
use burn_core::tensor::ops::PadMode;
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::{Conv2d, Conv2dConfig};
use burn_nn::{Initializer, Linear};

/// Four class tokens become the logarithms of two focal lengths and the principal point.
#[derive(Module, Debug)]
pub struct CameraHead {
    aggregate1: Block,
    aggregate2: Block,
    /// `[1, 4, c]`.
    latents_pos: Param<Tensor<3>>,
    in_features: Mlp,
    project_cls: Mlp,
    out: Mlp,
}

impl CameraHead {
    pub fn new(width: usize, device: &Device) -> Self {
        Self {
            aggregate1: Block::new(width, device),
            aggregate2: Block::new(width, device),
            latents_pos: zeros([1, 4, width], device),
            in_features: Mlp::new(width, 2, width, device),
            project_cls: Mlp::new(width, 4, width, device),
            out: Mlp::new(width, 2, 1, device),
        }
    }

    /// Of the tokens of all levels and their positions, `[4 n, c]`, and class tokens `[4, c]`:
    /// `[4, 1]`.
    pub fn forward(
        &self,
        features: Tensor<2>,
        positions: Tensor<2>,
        classes: Tensor<2>,
    ) -> Tensor<2> {
        let classes = self.project_cls.forward(classes);
        let context = self.in_features.forward(features + positions);
        let context = Tensor::cat(vec![context, classes.clone()], 0);
        let position = Some(self.latents_pos.val().squeeze_dim(0));
        let x = self
            .aggregate1
            .attending(classes, context.clone(), position.clone(), None);
        let x = self.aggregate2.attending(x, context, position, None);
        self.out.forward(x)
    }
}

/// Two class tokens become the logarithm of depth's scale, and its offset.
#[derive(Module, Debug)]
pub struct GlobalHead {
    in_features: Linear,
    project_rays: Linear,
    aggregate1: Block,
    aggregate2: Block,
    project_cls: Mlp,
    out: Mlp,
}

impl GlobalHead {
    pub fn new(width: usize, device: &Device) -> Self {
        Self {
            in_features: linear(width, width, true, device),
            project_rays: linear(CHANNELS, width, true, device),
            aggregate1: Block::new(width, device),
            aggregate2: Block::new(width, device),
            project_cls: Mlp::new(width, 4, width, device),
            out: Mlp::new(width, 2, 1, device),
        }
    }

    /// Of the tokens of each level `[n, c]`, class tokens `[2, c]` and encoded rays `[n, 99]`:
    /// `[2, 1]`.
    pub fn forward(&self, levels: &[Tensor<2>], classes: Tensor<2>, rays: Tensor<2>) -> Tensor<2> {
        let classes = self.project_cls.forward(classes);
        let rays = self.project_rays.forward(rays);
        let levels = levels
            .iter()
            .map(|x| self.in_features.forward(x.clone() + rays.clone()));
        let context = Tensor::cat(levels.chain([classes.clone()]).collect(), 0);
        let x = self
            .aggregate1
            .attending(classes, context.clone(), None, None);
        let x = self.aggregate2.attending(x, context, None, None);
        self.out.forward(x)
    }
}

/// Levels of the decoder, each of twice the size and half the channels of the one before.
const LEVELS: usize = 3;
/// Blocks that mix heads, at the coarsest level.
const BLOCKS: usize = 6;
/// Channels that each level gives to depth.
const OUT: usize = 16;
/// Half the side of the last kernel.
const EDGE: usize = 3;

/// The head. `process_layers` are `process_layers.0` in the checkpoint, whose other levels have
/// none.
#[derive(Module, Debug)]
pub struct DepthHead {
    to_latents: Mlp,
    features_channel_cat: Linear,
    aggregate_16: Block,
    prompt_camera: Block,
    rays_layers: Vec<Linear>,
    ups: Vec<Up>,
    process_layers: Vec<Block>,
    depth_mlp: Vec<Mlp>,
    to_depth: Conv2d,
}

/// What the head works on.
#[derive(Debug)]
pub struct DecoderInputs<'a> {
    /// Tokens of each level of the backbone, `[h w, c]`.
    pub levels: &'a [Tensor<2>],
    /// Their positions, `[4 h w, c]`.
    pub positions: Tensor<2>,
    pub rays: &'a Rays,
    /// Rows and columns of tokens.
    pub grid: [usize; 2],
}

impl DepthHead {
    pub fn new(width: usize, device: &Device) -> Self {
        let at = |level: usize| width >> level;
        let last = Conv2dConfig::new([LEVELS * OUT, 1], [2 * EDGE + 1, 2 * EDGE + 1]);
        Self {
            to_latents: Mlp::new(width, 2, width, device),
            features_channel_cat: linear(4 * width, width, true, device),
            aggregate_16: Block::new(width, device),
            prompt_camera: Block::new(width, device),
            rays_layers: (0..LEVELS)
                .map(|i| linear(CHANNELS, at(i), true, device))
                .collect(),
            ups: (0..LEVELS).map(|i| Up::new(at(i), device)).collect(),
            process_layers: (0..BLOCKS).map(|_| Block::new(width, device)).collect(),
            depth_mlp: (0..LEVELS)
                .map(|i| Mlp::new(at(i + 1), 1, OUT, device))
                .collect(),
            to_depth: last.with_initializer(Initializer::Zeros).init(device),
        }
    }

    /// The tokens that depth is made of, `[h w, c]`.
    pub fn latents(&self, scene: &DecoderInputs<'_>, rays: Tensor<2>) -> Tensor<2> {
        let levels = || scene.levels.to_vec();
        let together = self.features_channel_cat.forward(Tensor::cat(levels(), 1));
        let x = together.clone() + self.to_latents.forward(together);
        let x = self.aggregate_16.attending(
            x,
            Tensor::cat(levels(), 0),
            None,
            Some(scene.positions.clone()),
        );
        self.prompt_camera.attending(x, rays, None, None)
    }

    /// The rays of the pixels of level `level`, `[4^level h w, c / 2^level]`.
    pub fn encoded_rays(&self, scene: &DecoderInputs<'_>, level: usize) -> Tensor<2> {
        let [h, w] = scene.grid;
        let device = scene.positions.device();
        let rays = scene.rays.encoded(h << level, w << level, &device);
        self.rays_layers[level].forward(rays.cast(scene.positions.dtype()))
    }

    /// Tokens with their heads mixed, in view of their `rays`.
    pub fn processed(&self, x: Tensor<2>, rays: &Tensor<2>) -> Tensor<2> {
        let blocks = self.process_layers.iter();
        blocks.fold(x, |x, block| block.mixing_heads(x, rays.clone()))
    }

    /// `[1, 1, 14 h, 14 w]`.
    pub fn forward(&self, scene: &DecoderInputs<'_>) -> Tensor<4> {
        let [h, w] = scene.grid;
        let first = self.encoded_rays(scene, 0);
        let mut x = self.processed(self.latents(scene, first.clone()), &first);
        let mut outs = Vec::with_capacity(LEVELS);
        for (level, up) in self.ups.iter().enumerate() {
            let rays = match level {
                0 => first.clone(),
                _ => self.encoded_rays(scene, level),
            };
            x = up.forward(x + rays, h << level, w << level);
            let out = self.depth_mlp[level].forward(x.clone());
            outs.push(interpolated(
                map(out, h << (level + 1), w << (level + 1)),
                [14 * h, 14 * w],
                false,
            ));
        }
        outs.reverse();
        let edges = [(0, 0), (0, 0), (EDGE, EDGE), (EDGE, EDGE)];
        self.to_depth
            .forward(Tensor::cat(outs, 1).pad(edges, PadMode::Reflect))
    }
}

/// What follows the blocks: a shuffle of channels into pixels and two convolutions, beside a plain
/// enlargement. `up_depthwise` and `up_conv` are named `up.1` and `up.3` in the checkpoint,
/// `residual` is `residual.0`.
#[derive(Module, Debug)]
pub struct Up {
    convs: [ConvNext; 2],
    up_depthwise: Conv2d,
    up_conv: Conv2d,
    residual: Conv2d,
}

impl Up {
    pub fn new(width: usize, device: &Device) -> Self {
        Self {
            convs: std::array::from_fn(|_| ConvNext::new(width, norm(width, device), device)),
            up_depthwise: depthwise7(width / 4, device),
            up_conv: conv([width / 4, width / 2], 3, 1, true, device),
            residual: conv([width, width / 2], 1, 1, true, device),
        }
    }

    /// Of tokens `[h w, c]`: tokens `[4 h w, c / 2]`.
    pub fn forward(&self, x: Tensor<2>, h: usize, w: usize) -> Tensor<2> {
        let [_, c] = x.dims();
        let x = self
            .convs
            .iter()
            .fold(x.reshape([1, h, w, c]), |x, block| block.forward(x))
            .permute([0, 3, 1, 2]);
        let shuffled = relu(self.up_depthwise.forward(pixels_of_channels(x.clone())));
        tokens(
            self.up_conv.forward(shuffled)
                + interpolated(self.residual.forward(x), [2 * h, 2 * w], true),
        )
    }
}

/// Four channels as 2 by 2 pixels: `[1, c, h, w]` as `[1, c / 4, 2 h, 2 w]`.
fn pixels_of_channels(x: Tensor<4>) -> Tensor<4> {
    let [_, c, h, w] = x.dims();
    x.reshape([c / 4, 2, 2, h, w])
        .permute([0, 3, 1, 4, 2])
        .reshape([1, c / 4, 2 * h, 2 * w])
}

/// A map `[1, c, h, w]` as tokens `[h w, c]`.
pub fn tokens(x: Tensor<4>) -> Tensor<2> {
    let [_, c, h, w] = x.dims();
    x.reshape([c, h * w]).transpose()
}

/// Tokens `[h w, c]` as a map `[1, c, h, w]`.
pub fn map(x: Tensor<2>, h: usize, w: usize) -> Tensor<4> {
    let [_, c] = x.dims();
    x.transpose().reshape([1, c, h, w])
}
