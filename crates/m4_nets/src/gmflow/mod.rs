//! GMFlow: optical flow as global matching, two scales with refinement.
//!
//! - Paper: Xu, Zhang, Cai, Rezatofighi, Tao, "GMFlow: Learning Optical Flow via Global Matching", CVPR 2022; the section
//!   numbers in this folder are its.
//! - Upstream: haofeixu/gmflow, Apache-2.0. Weights (Apache-2.0): the entry `gmflow` of `minute4d weights list`, a checkpoint of 124
//!   tensors, 4,716,720 numbers.
//!
//! ```text
//! picture --backbone--> features at 1/8 and 1/4
//! 1/8: position, transformer (2 x 2 windows), global matching, propagation over the whole map
//! 1/4: the second picture's features warped by that flow; position, transformer (8 x 8 windows),
//!      matching within 4 pixels, propagation within 1; upsampling to the picture
//! ```
//!
//! Maps are `[height, width, channels]`. [`GmFlow::encode`] keeps what depends on one picture alone; the rest depends on the
//! pair. Both directions of a pair share everything at 1/8.

mod backbone;
mod matching;
mod propagation;
mod transformer;
mod upsampler;
mod windows;

use crate::flow::same_size;
use crate::padding::Padding;
use crate::{Compute, Flow, FlowError, LoadError, load};
use backbone::Backbone;
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::module::interpolate;
use burn_core::tensor::ops::{InterpolateMode, InterpolateOptions};
use burn_core::tensor::{Device, Tensor};
use m4_scene::RgbImage;
use propagation::Propagation;
use std::path::Path;
use transformer::Transformer;
use upsampler::Upsampler;
use windows::Windows;

/// Channels of the features.
const WIDTH: usize = 128;
/// Windows of attention at 1/8 and at 1/4, a side.
const SPLITS: [usize; 2] = [2, 8];
/// How far the matching at 1/4 looks, in its pixels.
const MATCH_RADIUS: usize = 4;

/// Sides are multiples of this: a quarter of them is cut into 8, an eighth into 2.
const MULTIPLE: usize = 32;
/// Mean and standard deviation of red, green and blue that the weights were trained with (ImageNet's).
const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
const STD: [f32; 3] = [0.229, 0.224, 0.225];

/// What the network keeps of one picture, for use in several pairs.
#[derive(Debug, Clone)]
pub struct Features {
    padding: Padding,
    /// `[h / 8, w / 8, 128]` of the padded picture.
    eighth: Tensor<3>,
    /// `[h / 4, w / 4, 128]` of the padded picture.
    quarter: Tensor<3>,
}

/// The network with its weights.
#[derive(Debug)]
pub struct GmFlow {
    net: Net,
    device: Device,
}

/// Fields as in the checkpoint.
#[derive(Module, Debug)]
struct Net {
    backbone: Backbone,
    transformer: Transformer,
    feature_flow_attn: Propagation,
    upsampler: Upsampler,
}

/// Names of the checkpoint that are not those of fields.
const RENAMES: [(&str, &str); 5] = [
    (r"\.downsample\.0\.", ".downsample.conv."),
    (r"\.mlp\.0\.", ".mlp.expand."),
    (r"\.mlp\.2\.", ".mlp.contract."),
    (r"^upsampler\.0\.", "upsampler.hidden."),
    (r"^upsampler\.2\.", "upsampler.weights."),
];

impl GmFlow {
    /// The network with the weights of the checkpoint at `path`, on `device`.
    ///
    /// # Errors
    ///
    /// [`LoadError`] if the file cannot be read or holds another network.
    pub fn load(path: &Path, on: impl Into<Compute>) -> Result<Self, LoadError> {
        let on: Compute = on.into();
        let device = &on.device;
        let mut net = Net {
            backbone: Backbone::new(WIDTH, device),
            transformer: Transformer::new(WIDTH, device),
            feature_flow_attn: Propagation::new(WIDTH, device),
            upsampler: Upsampler::new(WIDTH, device),
        };
        load::fill(&mut net, "GMFlow", path, &RENAMES, |_| false)?;
        Ok(Self {
            net,
            device: device.clone(),
        })
    }

    /// Numbers that the network learned.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.net.num_params()
    }

    /// The features of `image`.
    ///
    /// # Errors
    ///
    /// [`FlowError::Empty`] if it has no pixels.
    pub fn encode(&self, image: &RgbImage) -> Result<Features, FlowError> {
        let padding = Padding::of(image.width(), image.height(), MULTIPLE, MULTIPLE)?;
        let image = padding.tensor(image, |x, channel| (x - MEAN[channel]) / STD[channel], &self.device);
        let (quarter, eighth) = self.net.backbone.forward(image);
        let map = |maps: Tensor<4>| maps.squeeze_dim::<3>(0).permute([1, 2, 0]);
        Ok(Features {
            padding,
            eighth: map(eighth),
            quarter: map(quarter),
        })
    }

    /// The flow from `a` to `b`.
    ///
    /// # Errors
    ///
    /// [`FlowError`] if they differ in size, have no pixels, or the device fails.
    pub fn flow(&self, a: &RgbImage, b: &RgbImage) -> Result<Flow, FlowError> {
        same_size(a.size(), b.size())?;
        self.flow_between(&self.encode(a)?, &self.encode(b)?)
    }

    /// The flow from the picture of `a` to that of `b`.
    ///
    /// # Errors
    ///
    /// [`FlowError`] if they differ in size or the device fails.
    pub fn flow_between(&self, a: &Features, b: &Features) -> Result<Flow, FlowError> {
        let [map_a, map_b] = self.coarse_features(a, b)?;
        self.refined(a, b, self.coarse_flow(map_a, map_b))
    }

    /// The flows from the picture of `a` to that of `b`, and back.
    ///
    /// # Errors
    ///
    /// [`FlowError`] if they differ in size or the device fails.
    pub fn flow_both(&self, a: &Features, b: &Features) -> Result<(Flow, Flow), FlowError> {
        let [map_a, map_b] = self.coarse_features(a, b)?;
        let forward = self.refined(a, b, self.coarse_flow(map_a.clone(), map_b.clone()))?;
        let back = self.refined(b, a, self.coarse_flow(map_b, map_a))?;
        Ok((forward, back))
    }

    /// Features at 1/8 that know of each other.
    fn coarse_features(&self, a: &Features, b: &Features) -> Result<[Tensor<3>; 2], FlowError> {
        let size = |features: &Features| (features.padding.width, features.padding.height);
        same_size(size(a), size(b))?;
        Ok(self.attended(a.eighth.clone(), b.eighth.clone(), SPLITS[0]))
    }

    /// `a` and `b` with positions, each attended to by the other.
    fn attended(&self, a: Tensor<3>, b: Tensor<3>, splits: usize) -> [Tensor<3>; 2] {
        let [height, width, _] = a.dims();
        let windows = Windows { height, width, splits };
        let both = Tensor::stack::<4>(vec![a, b], 0) + windows.position(WIDTH, &self.device);
        let both = self.net.transformer.forward(both, windows);
        [0, 1].map(|i| both.clone().narrow(0, i, 1).squeeze_dim(0))
    }

    /// The flow at 1/8 of features that know of each other.
    fn coarse_flow(&self, a: Tensor<3>, b: Tensor<3>) -> Tensor<3> {
        let flow = matching::global(a.clone(), b);
        self.net.feature_flow_attn.global(a, flow)
    }

    /// The flow of the pictures, from that at 1/8.
    fn refined(&self, a: &Features, b: &Features, flow: Tensor<3>) -> Result<Flow, FlowError> {
        let flow = doubled(flow);
        let warped = matching::warp(b.quarter.clone(), flow.clone());
        let [map_a, map_b] = self.attended(a.quarter.clone(), warped, SPLITS[1]);
        let flow = flow + matching::local(map_a.clone(), map_b, MATCH_RADIUS);
        let flow = self.net.feature_flow_attn.local(map_a.clone(), flow);
        a.padding.crop(self.net.upsampler.forward(map_a, flow))
    }
}

/// Flow `[h, w, 2]` on a map of twice the size, in its pixels; bilinear, corner on corner.
fn doubled(flow: Tensor<3>) -> Tensor<3> {
    let [h, w, _] = flow.dims();
    let options = InterpolateOptions::new(InterpolateMode::Bilinear)
        .with_align_corners(true)
        .with_output_size([2 * h, 2 * w]);
    interpolate(flow.permute([2, 0, 1]).unsqueeze::<4>(), options)
        .squeeze_dim::<3>(0)
        .permute([1, 2, 0])
        .mul_scalar(2.0)
}
