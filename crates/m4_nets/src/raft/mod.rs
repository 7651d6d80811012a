//! RAFT: optical flow by repeated lookups in all-pairs correlations.
//!
//! - Paper: Teed and Deng, "RAFT: Recurrent All-Pairs Field Transforms for Optical Flow", ECCV
//!   2020; the section numbers in this folder are its. The large model, as `MegaSaM` runs it
//!   (docs/spec/front-end.md 1.7).
//! - Upstream: princeton-vl/RAFT, BSD-3. Weights: the entry `raft-things` of
//!   `minute4d weights list`, 5,257,536 learned numbers.
//!
//! ```text
//! image --fnet--> features at 1/8, which are compared;  --cnet--> hidden state and context
//! a pair, again and again:  correlations around where the flow points --motion encoder--> motion
//!                           hidden state, context, motion --recurrent unit--> hidden state --flow head--> change of the flow
//! hidden state --mask head--> weights of upsampling;  flow at 1/8 --convex upsampling--> flow
//! ```
//!
//! [`Raft::encode`] keeps what depends on one image alone; both directions of a pair share it and
//! are computed side by side. Inside, maps are `[n, channels, height, width]`; flow is in 32 bits
//! whatever the type of the weights.

#[cfg(test)]
mod tests;
mod update;

use crate::correlation::{self, FeatureMap, Pyramid};
use crate::error::{numbers, refuse};
use crate::ops::{convex_upsample, tensor};
use crate::residual::{Encoder, Norm};
use crate::{Compute, LoadError, NetError, load};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::{relu, tanh};
use burn_core::tensor::{DType, Device, Tensor, TensorData};
use m4_core::{Flow, RgbImage};
use std::path::Path;
use update::{FACTOR, UpdateBlock};

/// Channels that are compared, and channels of hidden state and context together.
const WIDTH: usize = 256;
/// Sizes at which an image is compared, each half of the one before.
const LEVELS: usize = 4;
/// How far lookups reach, in pixels of each level.
const RADIUS: usize = 4;
/// Sides are padded to this at least: the coarsest level then has two pixels per side, the fewest
/// that the published network can look up in.
const LEAST: usize = (2 * FACTOR) << (LEVELS - 1);

/// The flow of one direction of a pair.
#[derive(Debug, Clone, PartialEq)]
pub struct RaftFlow {
    /// In the image's size.
    pub flow: Flow,
    /// At an eighth of the padded image's size, in pixels of that size: what another pair that ends
    /// in the same image may start from.
    pub low: Flow,
}

/// What the network keeps of one image, for use in several pairs.
#[derive(Debug, Clone)]
pub struct Features {
    padding: Padding,
    /// What is looked up, and what is looked up in.
    source: FeatureMap,
    target: Pyramid,
    /// `[1, 128, h / 8, w / 8]`, the state before the first iteration.
    hidden: Tensor<4>,
    /// `[1, 128, h / 8, w / 8]`.
    context: Tensor<4>,
}

/// The network with its weights.
#[derive(Debug)]
pub struct Raft {
    net: Net,
    device: Device,
}

#[derive(Module, Debug)]
struct Net {
    fnet: Encoder,
    cnet: Encoder,
    update_block: UpdateBlock,
}

/// Names of the checkpoint that are not those of fields.
const RENAMES: [(&str, &str); 5] = [
    (r"^module\.", ""),
    (r"\.downsample\.0\.", ".downsample.conv."),
    (r"\.downsample\.1\.", ".downsample.norm."),
    (r"^update_block\.mask\.0\.", "update_block.mask.hidden."),
    (r"^update_block\.mask\.2\.", "update_block.mask.weights."),
];

/// Counters of training, and the norm of a shortcut under its second name.
fn unneeded(name: &str) -> bool {
    name.ends_with(".num_batches_tracked") || name.contains(".norm3.")
}

impl Net {
    /// Waiting for its weights.
    fn new(device: &Device) -> Self {
        Self {
            fnet: Encoder::new([64, 96, 128], WIDTH, Norm::Instance, device),
            cnet: Encoder::new([64, 96, 128], WIDTH, Norm::Batch, device),
            update_block: UpdateBlock::new(correlation::taps(LEVELS, RADIUS), device),
        }
    }
}

impl Raft {
    /// The network with the weights of the checkpoint at `path`, on `device`. Names may begin with
    /// `module.`, as in the published files.
    ///
    /// # Errors
    ///
    /// [`LoadError`] if the file cannot be read or holds another network.
    pub fn load(path: &Path, on: impl Into<Compute>) -> Result<Self, LoadError> {
        let on: Compute = on.into();
        let mut net = Net::new(&on.device);
        load::fill(&mut net, "RAFT", path, &RENAMES, unneeded)?;
        Ok(Self {
            net: on.fit(net),
            device: on.device,
        })
    }

    /// What the network keeps of `image`.
    ///
    /// # Errors
    ///
    /// [`NetError::Input`] if it has no pixels.
    pub fn encode(&self, image: &RgbImage) -> Result<Features, NetError> {
        let padding = Padding::of(image.size())?;
        let image = padding.tensor(image, &self.device);
        let image = image.cast(self.net.fnet.dtype());
        let compared = self
            .net
            .fnet
            .forward(image.clone(), Norm::Instance)
            .squeeze_dim::<3>(0);
        let compared = compared.permute([1, 2, 0]);
        let state = self.net.cnet.forward(image, Norm::Batch);
        Ok(Features {
            padding,
            source: FeatureMap::new(compared.clone()),
            target: Pyramid::new(compared, LEVELS),
            hidden: tanh(state.clone().narrow(1, 0, update::WIDTH)),
            context: relu(state.narrow(1, update::WIDTH, update::WIDTH)),
        })
    }

    /// The flows from the image of `a` to that of `b`, and back, after `iterations` (22 are usual).
    /// They start from `init`, in the same order, or from no motion.
    ///
    /// # Errors
    ///
    /// [`NetError`] if the images differ in size, `init` is not of their size or has too few
    /// numbers, there is no iteration, or the device fails.
    pub fn flow_both(
        &self,
        a: &Features,
        b: &Features,
        iterations: usize,
        init: Option<[&Flow; 2]>,
    ) -> Result<[RaftFlow; 2], NetError> {
        let (one, other) = (a.padding.size, b.padding.size);
        if one != other {
            return refuse(format!(
                "flow needs two images of one size, these have {} x {} and {} x {} pixels",
                one.0, one.1, other.0, other.1
            ));
        }
        if iterations == 0 {
            return refuse("flow needs at least one iteration; 22 are usual");
        }
        let update = &self.net.update_block;
        let both =
            |of: fn(&Features) -> &Tensor<4>| Tensor::cat(vec![of(a).clone(), of(b).clone()], 0);
        let unit = update.gru.with_context(&both(|features| &features.context));
        let mut hidden = both(|features| &features.hidden);
        let dtype = hidden.dtype();
        let [_, _, h, w] = hidden.dims();
        let here = self.whole_positions(h, w);
        let mut flow = match init {
            Some(init) => Tensor::cat(
                vec![self.start(init[0], h, w)?, self.start(init[1], h, w)?],
                0,
            ),
            None => Tensor::zeros([2, h, w, 2], (&self.device, DType::F32)),
        };
        for _ in 0..iterations {
            let at = here.clone() + flow.clone();
            let look = |source: &Features, target: &Features, i| {
                let at = at.clone().narrow(0, i, 1).squeeze_dim(0);
                correlation::scores(&source.source, &target.target, at, RADIUS)
            };
            let correlations = Tensor::stack::<4>(vec![look(a, b, 0), look(b, a, 1)], 0);
            let motion = update.encoder.forward(
                channels_first(correlations).cast(dtype),
                channels_first(flow.clone()).cast(dtype),
            );
            hidden = unit.forward(hidden, &motion);
            let change = update.flow_head.forward(hidden.clone()).cast(DType::F32);
            flow = flow + change.permute([0, 2, 3, 1]);
        }
        let weights = update.mask.forward(hidden).cast(DType::F32);
        let result = |features: &Features, i| {
            let flow: Tensor<3> = flow.clone().narrow(0, i, 1).squeeze_dim(0);
            let weights = weights.clone().narrow(0, i, 1).squeeze_dim(0);
            Ok(RaftFlow {
                flow: features
                    .padding
                    .crop(convex_upsample(flow.clone(), weights, FACTOR))?,
                low: read(flow)?,
            })
        };
        Ok([result(a, 0)?, result(b, 1)?])
    }

    /// Column and row of each pixel of a map, `[1, h, w, 2]`.
    fn whole_positions(&self, h: usize, w: usize) -> Tensor<4> {
        let at = (0..h * w)
            .flat_map(|i| [(i % w) as f32, (i / w) as f32])
            .collect();
        self.in_32_bits(at, [1, h, w, 2])
    }

    /// `low` as `[1, h, w, 2]`.
    fn start(&self, low: &Flow, h: usize, w: usize) -> Result<Tensor<4>, NetError> {
        if (low.width, low.height, low.u.len(), low.v.len()) != (w, h, w * h, w * h) {
            return refuse(format!(
                "the flow to start from has {} x {} pixels ({} numbers), these images need {w} x {h}: start from that of \
                 another pair of images of the same size",
                low.width,
                low.height,
                low.u.len().min(low.v.len())
            ));
        }
        let pairs = low
            .u
            .iter()
            .zip(&low.v)
            .flat_map(|(&u, &v)| [u, v])
            .collect();
        Ok(self.in_32_bits(pairs, [1, h, w, 2]))
    }

    fn in_32_bits(&self, values: Vec<f32>, shape: [usize; 4]) -> Tensor<4> {
        Tensor::from_data(TensorData::new(values, shape), (&self.device, DType::F32))
    }
}

/// `[n, h, w, c]` as `[n, c, h, w]`.
fn channels_first(x: Tensor<4>) -> Tensor<4> {
    x.permute([0, 3, 1, 2])
}

/// An image in the middle of one whose sides are multiples of [`FACTOR`] and no less than
/// [`LEAST`], its edges repeated.
#[derive(Debug, Clone, Copy)]
struct Padding {
    size: (usize, usize),
    /// Width and height that the network works with.
    padded: (usize, usize),
}

impl Padding {
    fn of(size: (usize, usize)) -> Result<Self, NetError> {
        if size.0 == 0 || size.1 == 0 {
            return refuse("flow needs images with pixels");
        }
        let up = |side: usize| side.next_multiple_of(FACTOR).max(LEAST);
        Ok(Self {
            size,
            padded: (up(size.0), up(size.1)),
        })
    }

    /// Columns left of the image and rows above it.
    fn before(self) -> (usize, usize) {
        (
            (self.padded.0 - self.size.0) / 2,
            (self.padded.1 - self.size.1) / 2,
        )
    }

    /// The padded image from -1 to 1, `[1, 3, padded height, padded width]`.
    fn tensor(self, image: &RgbImage, device: &Device) -> Tensor<4> {
        let ((width, height), (left, top)) = (self.padded, self.before());
        let inside =
            |at: usize, before: usize, side: usize| at.saturating_sub(before).min(side - 1);
        let mut values = Vec::with_capacity(3 * width * height);
        for channel in 0..3 {
            for y in 0..height {
                let row = image.row(inside(y, top, self.size.1));
                let value = |x| f32::from(row[inside(x, left, self.size.0)][channel]) / 255.0;
                values.extend((0..width).map(|x| 2.0 * value(x) - 1.0));
            }
        }
        tensor(values, [1, 3, height, width], device)
    }

    /// The flow of the image out of that of the padded one, `[padded height, padded width, 2]`.
    fn crop(self, flow: Tensor<3>) -> Result<Flow, NetError> {
        let (left, top) = self.before();
        read(
            flow.narrow(0, top, self.size.1)
                .narrow(1, left, self.size.0),
        )
    }
}

/// Flow `[height, width, 2]` off the device.
fn read(flow: Tensor<3>) -> Result<Flow, NetError> {
    let [height, width, _] = flow.dims();
    let (u, v) = numbers(flow)?
        .as_chunks::<2>()
        .0
        .iter()
        .map(|&[u, v]| (u, v))
        .unzip();
    Ok(Flow {
        width,
        height,
        u,
        v,
    })
}
