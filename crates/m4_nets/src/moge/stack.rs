//! The decoder and the heads: maps at sizes that double, each with what comes from the smaller one.
//!
//! ```text
//! level i:  x = enlarged(level i - 1) + 1 x 1(input i);  x = blocks(x);  output i = 1 x 1(x)
//! ```
//!
//! How many levels there are and how wide they are is read off a checkpoint ([`StackLayout`]).
//! Convolutions of 3 x 3 repeat the edges.

use super::layout::{Level, StackLayout, Up};
use crate::dinov2::{BackboneSize, DinoV2};
use crate::ops::{conv, convolve, convolve_edges, interpolated, upscaling_conv};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::activation::relu;
use burn_core::tensor::{Device, Tensor};
use burn_nn::Initializer;
use burn_nn::conv::{Conv2d, ConvTranspose2d};

/// The decoder or a head.
#[derive(Module, Debug)]
pub struct Stack {
    input_blocks: Vec<Option<Conv2d>>,
    resamplers: Vec<Enlarge>,
    res_blocks: Vec<Vec<Residual>>,
    output_blocks: Vec<Option<Conv2d>>,
}

/// Twice the rows and columns. Named `0` (which a bilinear step has not) and `1` in the checkpoint.
#[derive(Module, Debug)]
struct Enlarge {
    transposed: Option<ConvTranspose2d>,
    conv: Conv2d,
}

/// Two convolutions beside a shortcut. Named `layers.2` and `layers.5` in the checkpoint.
#[derive(Module, Debug)]
struct Residual {
    conv1: Conv2d,
    conv2: Conv2d,
}

/// A convolution of 3 x 3.
fn wide(channels: [usize; 2], device: &Device) -> Conv2d {
    conv(channels, 3, 1, true, device)
}

impl Residual {
    fn new(width: usize, hidden: usize, device: &Device) -> Self {
        Self {
            conv1: wide([width, hidden], device),
            conv2: wide([hidden, width], device),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = convolve_edges(relu(x.clone()), &self.conv1);
        convolve_edges(relu(y), &self.conv2) + x
    }
}

impl Enlarge {
    fn new(up: Up, from: usize, to: usize, device: &Device) -> Self {
        match up {
            Up::Transposed => Self {
                transposed: Some(upscaling_conv([from, to], 2, device)),
                conv: wide([to, to], device),
            },
            Up::Bilinear => Self {
                transposed: None,
                conv: wide([from, to], device),
            },
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let x = match &self.transposed {
            Some(twice) => twice.forward(x),
            None => {
                let [_, _, h, w] = x.dims();
                interpolated(x, [2 * h, 2 * w], false)
            }
        };
        convolve_edges(x, &self.conv)
    }
}

impl Stack {
    pub fn new(layout: &StackLayout, device: &Device) -> Self {
        let levels = &layout.levels;
        let single = |from: usize, to: usize| conv([from, to], 1, 1, true, device);
        let blocks = |level: &Level| {
            let block = |&hidden: &usize| Residual::new(level.width, hidden, device);
            level.blocks.iter().map(block).collect()
        };
        let ups = levels.iter().zip(levels.iter().skip(1));
        Self {
            input_blocks: levels
                .iter()
                .map(|l| l.input.map(|from| single(from, l.width)))
                .collect(),
            resamplers: ups
                .map(|(from, to)| Enlarge::new(from.up, from.width, to.width, device))
                .collect(),
            res_blocks: levels.iter().map(blocks).collect(),
            output_blocks: levels
                .iter()
                .map(|l| l.output.map(|to| single(l.width, to)))
                .collect(),
        }
    }

    pub fn levels(&self) -> usize {
        self.res_blocks.len()
    }

    /// What every level gives away, of `inputs` `[b, c, 2^i h, 2^i w]`, one for every level.
    pub fn forward(&self, inputs: &[Tensor<4>]) -> Vec<Tensor<4>> {
        let mut out: Vec<Tensor<4>> = Vec::with_capacity(inputs.len());
        let mut below = None;
        for (i, input) in inputs.iter().enumerate() {
            let x = self.level(i, below, input.clone());
            out.push(through(&self.output_blocks[i], x.clone()));
            below = Some(x);
        }
        out
    }

    /// What the last level gives away, of at least one level.
    pub fn last(&self, inputs: &[Tensor<4>]) -> Tensor<4> {
        let (first, rest) = (inputs[0].clone(), inputs.iter().enumerate().skip(1));
        let x = rest.fold(self.level(0, None, first), |below, (i, input)| {
            self.level(i, Some(below), input.clone())
        });
        through(&self.output_blocks[inputs.len() - 1], x)
    }

    /// Level `i` out of what is `below` it and its `input`.
    fn level(&self, i: usize, below: Option<Tensor<4>>, input: Tensor<4>) -> Tensor<4> {
        let input = through(&self.input_blocks[i], input);
        let x = match below {
            Some(below) => self.resamplers[i - 1].forward(below) + input,
            None => input,
        };
        self.res_blocks[i]
            .iter()
            .fold(x, |x, block| block.forward(x))
    }
}

/// `single` of `x`, or `x` itself.
fn through(single: &Option<Conv2d>, x: Tensor<4>) -> Tensor<4> {
    match single {
        Some(single) => convolve([x], single),
        None => x,
    }
}

#[derive(Module, Debug)]
pub struct Encoder {
    backbone: DinoV2,
    output_projections: Vec<Conv2d>,
    image_mean: Param<Tensor<4>>,
    image_std: Param<Tensor<4>>,
}

impl Encoder {
    /// Of `taps` blocks of a backbone of `size`, with `width` channels.
    pub fn new(size: BackboneSize, taps: usize, width: usize, device: &Device) -> Self {
        let single = |_| conv([size.width(), width], 1, 1, true, device);
        Self {
            backbone: DinoV2::new(size, device),
            output_projections: (0..taps).map(single).collect(),
            image_mean: Initializer::Zeros.init([1, 3, 1, 1], device),
            image_std: Initializer::Ones.init([1, 3, 1, 1], device),
        }
    }

    /// Of images `[b, 3, 14 h, 14 w]` from 0 to 1: the map `[b, c, h, w]`, and the class token of
    /// the last tap, `[b, c']`.
    pub fn forward(
        &self,
        images: Tensor<4>,
        taps: &[usize],
        [h, w]: [usize; 2],
    ) -> (Tensor<4>, Tensor<2>) {
        let (mean, std) = (self.image_mean.val(), self.image_std.val());
        let images = (images.cast(mean.dtype()) - mean) / std;
        let mut run = self.backbone.run(images);
        let mut sum: Option<Tensor<4>> = None;
        let mut tap = run.tap();
        for (&block, single) in taps.iter().zip(&self.output_projections) {
            run.through(block);
            tap = run.tap();
            let [b, _, c] = tap.patches.dims();
            let map = single.forward(tap.patches.clone().swap_dims(1, 2).reshape([b, c, h, w]));
            sum = Some(match sum {
                Some(sum) => sum + map,
                None => map,
            });
        }
        let [b, _, c] = tap.patches.dims();
        let map = sum.unwrap_or_else(|| tap.patches.swap_dims(1, 2).reshape([b, c, h, w]));
        (map, tap.class)
    }
}
