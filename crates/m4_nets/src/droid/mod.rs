//! MegaSaM's tracking network: DROID-SLAM's recurrent update with a head that detects dynamic
//! pixels.
//!
//! - Papers: Teed and Deng, "DROID-SLAM: Deep Visual SLAM for Monocular, Stereo, and RGB-D
//!   Cameras", NeurIPS 2021; Li et al., "MegaSaM: Accurate, Fast, and Robust Structure and Motion
//!   from Casual Dynamic Videos", CVPR 2025, section 3.2.
//! - Upstreams: princeton-vl/DROID-SLAM (BSD-3), mega-sam/mega-sam (Apache-2.0). Weights (CC-BY
//!   4.0): a checkpoint of 130 tensors, 5,192,467 numbers, of which [`DroidNet`] leaves out those
//!   that only training used.
//!
//! ```text
//! image --fnet--> features at 1/8        --cnet--> hidden (tanh), context (relu)
//! edge: correlation around where geometry sees the pixels, motion --update(hidden, context)--> hidden, delta, weight
//! all edges of a source --mean--> eta (damping of disparities), upmask; how likely each edge's pixels are static
//! ```
//!
//! [`DroidNet`] is the network, [`DroidMemory`] what it keeps of a clip: features of frames and
//! hidden states of edges, within a budget of memory. Positions are pixels of the grid at 1/8 whose
//! centres are whole numbers, u to the right, v down.
//!
//! What a frame's context adds to the recurrent unit is computed once for all edges of the frame,
//! and the two gates that read the same numbers are one convolution; upstream does both for every
//! edge in every step.

mod memory;
#[cfg(test)]
mod tests;
mod update;

pub use memory::{DroidMemory, EdgeUpdate, MemoryOptions, Storage};

use crate::error::refuse;
use crate::ops::{IMAGENET_MEAN, IMAGENET_STD, planes, tanh, tensor};
use crate::residual::{Encoder, Norm};
use crate::{Compute, LoadError, NetError, load};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{DType, Device, Tensor};
use m4_core::RgbImage;
use std::path::Path;
use update::{ArrangedGru, Update};

const NAME: &str = "MegaSaM's tracking network";
/// Channels of features, hidden states and contexts.
const WIDTH: usize = 128;

/// Names of the checkpoint that are not those of fields.
const RENAMES: [(&str, &str); 5] = [
    (r"^module\.", ""),
    (r"\.downsample\.0\.", ".downsample.conv."),
    (
        r"\.(corr_encoder|flow_encoder|weight|delta|logits_2)\.0\.",
        ".${1}.hidden.",
    ),
    (
        r"\.(corr_encoder|flow_encoder|weight|delta|logits_2)\.2\.",
        ".${1}.out.",
    ),
    (r"\.agg\.(eta|upmask)\.0\.", ".agg.${1}."),
];

/// Tensors of the checkpoint (by the fields' names) that only training used.
const UNNEEDED: [&str; 3] = [
    "update.agg_motion.conv4.",
    "update.agg_motion.norm_4.",
    "update.agg_motion.eta.",
];

/// The network with its weights.
#[derive(Debug)]
pub struct DroidNet {
    net: Net,
    gru: ArrangedGru,
    device: Device,
}

#[derive(Module, Debug)]
struct Net {
    fnet: Encoder,
    cnet: Encoder,
    update: Update,
}

impl DroidNet {
    /// The network with the weights of the checkpoint at `path`, on `device`. Weights and steps may
    /// have two outputs, as the network uses, or three, as published.
    ///
    /// # Errors
    ///
    /// [`LoadError`] if the file cannot be read or holds another network.
    pub fn load(path: &Path, on: impl Into<Compute>) -> Result<Self, LoadError> {
        let on: Compute = on.into();
        let device = &on.device;
        // the published weights and steps have a third output, which counts for nothing
        let shapes = load::shapes(NAME, path, &RENAMES)?;
        let rows = shapes
            .get("update.weight.out.weight")
            .and_then(|shape| shape.first().copied());
        let rows = rows.map_or(2, |rows| rows.clamp(2, 3));
        let mut net = Net {
            fnet: Encoder::new([32, 64, 128], WIDTH, Norm::Instance, device),
            cnet: Encoder::new([32, 64, 128], 2 * WIDTH, Norm::None, device),
            update: Update::new(rows, device),
        };
        load::fill(&mut net, NAME, path, &RENAMES, |name| {
            UNNEEDED.iter().any(|start| name.starts_with(start))
        })?;
        net.update.keep_two_rows();
        let net = on.fit(net);
        Ok(Self {
            gru: net.update.gru.arranged(),
            net,
            device: device.clone(),
        })
    }

    fn dtype(&self) -> DType {
        self.gru.dtype()
    }

    /// Features of `image` for correlation, `[1, 128, h / 8, w / 8]`.
    fn features(&self, image: &RgbImage) -> Result<Tensor<4>, NetError> {
        let image = normalised(image, &self.device)?.cast(self.dtype());
        Ok(self.net.fnet.forward(image, Norm::Instance))
    }

    /// The hidden state that edges from `image` start with, and its context,
    /// `[1, 128, h / 8, w / 8]` each.
    fn state(&self, image: &RgbImage) -> Result<[Tensor<4>; 2], NetError> {
        let image = normalised(image, &self.device)?.cast(self.dtype());
        let both = self.net.cnet.forward(image, Norm::None);
        let half = |k: usize| both.clone().narrow(1, k * WIDTH, WIDTH);
        Ok([tanh(half(0)), relu(half(1))])
    }
}

/// Sides are multiples of this.
const MULTIPLE: usize = 8;
/// The smallest side: correlation is pooled down to an eighth of an eighth, which must have pixels
/// (upstream's limit, too).
const SMALLEST: usize = 128;

/// Fails unless the network takes images of this size.
fn check((width, height): (usize, usize)) -> Result<(), NetError> {
    if [width, height]
        .iter()
        .any(|&side| side < SMALLEST || side % MULTIPLE != 0)
    {
        return refuse(format!(
            "the tracking network takes images whose sides are multiples of 8 and at least 128 px, this has {width} x \
             {height}; resize and crop it"
        ));
    }
    Ok(())
}

/// `image` as `[1, 3, h, w]`, normalised.
fn normalised(image: &RgbImage, device: &Device) -> Result<Tensor<4>, NetError> {
    check(image.size())?;
    let (width, height) = image.size();
    let values = planes(image, IMAGENET_MEAN, IMAGENET_STD);
    Ok(tensor(values, [1, 3, height, width], device))
}
