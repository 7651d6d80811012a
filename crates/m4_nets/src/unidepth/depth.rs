//! The logarithm of depth, up to scale and offset.

use super::layers::{Block, Mlp};
use super::rays::{self, Rays};
use super::up::{Up, map};
use crate::ops::linear;
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::module::interpolate;
use burn_core::tensor::ops::{InterpolateMode, InterpolateOptions, PadMode};
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::{Conv2d, Conv2dConfig};
use burn_nn::{Initializer, Linear};

/// Levels of the decoder, each of twice the size and half the channels of the one before.
const LEVELS: usize = 3;
/// Blocks that mix heads, at the coarsest level.
const BLOCKS: usize = 6;
/// Channels that each level gives to depth.
const OUT: usize = 16;
/// Half the side of the last kernel.
const EDGE: usize = 3;

/// The head. `process_layers` are `process_layers.0` in the checkpoint, whose other levels have none.
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
pub struct Scene<'a> {
    /// Tokens of each level of the backbone, `[h w, c]`.
    pub levels: &'a [Tensor<2>],
    /// Their positions, `[4 h w, c]`.
    pub positions: Tensor<2>,
    /// Where the pixels look.
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
            rays_layers: (0..LEVELS).map(|i| linear(rays::CHANNELS, at(i), true, device)).collect(),
            ups: (0..LEVELS).map(|i| Up::new(at(i), device)).collect(),
            process_layers: (0..BLOCKS).map(|_| Block::new(width, device)).collect(),
            depth_mlp: (0..LEVELS).map(|i| Mlp::new(at(i + 1), 1, OUT, device)).collect(),
            to_depth: last.with_initializer(Initializer::Zeros).init(device),
        }
    }

    /// The tokens that depth is made of, `[h w, c]`.
    pub fn latents(&self, scene: &Scene<'_>, rays: Tensor<2>) -> Tensor<2> {
        let levels = || scene.levels.to_vec();
        let together = self.features_channel_cat.forward(Tensor::cat(levels(), 1));
        let x = together.clone() + self.to_latents.forward(together);
        let x = self.aggregate_16.attending(x, Tensor::cat(levels(), 0), None, Some(scene.positions.clone()));
        self.prompt_camera.attending(x, rays, None, None)
    }

    /// The rays of the pixels of level `level`, `[4^level h w, c / 2^level]`.
    pub fn encoded_rays(&self, scene: &Scene<'_>, level: usize) -> Tensor<2> {
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
    pub fn forward(&self, scene: &Scene<'_>) -> Tensor<4> {
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
            outs.push(enlarged(map(out, h << (level + 1), w << (level + 1)), [14 * h, 14 * w]));
        }
        outs.reverse();
        let edges = [(0, 0), (0, 0), (EDGE, EDGE), (EDGE, EDGE)];
        self.to_depth.forward(Tensor::cat(outs, 1).pad(edges, PadMode::Reflect))
    }
}

/// `x` with `size` rows and columns, bilinear.
fn enlarged(x: Tensor<4>, size: [usize; 2]) -> Tensor<4> {
    let options = InterpolateOptions::new(InterpolateMode::Bilinear).with_align_corners(false).with_output_size(size);
    interpolate(x, options)
}
