//! The camera, and scale and offset of depth: what the whole image tells, through its class tokens.

use super::layers::{Block, Mlp};
use super::rays;
use crate::ops::{linear, zeros};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{Device, Tensor};
use burn_nn::Linear;

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

    /// Of the tokens of all levels and their positions, `[4 n, c]`, and class tokens `[4, c]`: `[4, 1]`.
    pub fn forward(&self, features: Tensor<2>, positions: Tensor<2>, classes: Tensor<2>) -> Tensor<2> {
        let classes = self.project_cls.forward(classes);
        let context = self.in_features.forward(features + positions);
        let context = Tensor::cat(vec![context, classes.clone()], 0);
        let position = Some(self.latents_pos.val().squeeze_dim(0));
        let x = self.aggregate1.attending(classes, context.clone(), position.clone(), None);
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
            project_rays: linear(rays::CHANNELS, width, true, device),
            aggregate1: Block::new(width, device),
            aggregate2: Block::new(width, device),
            project_cls: Mlp::new(width, 4, width, device),
            out: Mlp::new(width, 2, 1, device),
        }
    }

    /// Of the tokens of each level `[n, c]`, class tokens `[2, c]` and encoded rays `[n, 99]`: `[2, 1]`.
    pub fn forward(&self, levels: &[Tensor<2>], classes: Tensor<2>, rays: Tensor<2>) -> Tensor<2> {
        let classes = self.project_cls.forward(classes);
        let rays = self.project_rays.forward(rays);
        let levels = levels.iter().map(|x| self.in_features.forward(x.clone() + rays.clone()));
        let context = Tensor::cat(levels.chain([classes.clone()]).collect(), 0);
        let x = self.aggregate1.attending(classes, context.clone(), None, None);
        let x = self.aggregate2.attending(x, context, None, None);
        self.out.forward(x)
    }
}
