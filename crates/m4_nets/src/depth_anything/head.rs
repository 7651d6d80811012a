//! The head (DPT): the maps of four blocks at four sizes, fused from coarse to fine.
//!
//! ```text
//! 4 maps [c, h, w] --1 x 1--> x 4, x 2, x 1, x 1/2 --3 x 3--> 4 levels --fusion 4, 3, 2, 1--> [f, 8 h, 8 w]
//!     --3 x 3, bilinear to 14 h x 14 w, 3 x 3, 1 x 1--> [1, 14 h, 14 w]
//! ```
//!
//! Bilinear is corner on corner here.

use crate::dinov2::{BackboneSize, PATCH, Tap};
use crate::ops::{conv, convolve, interpolated, upscaling_conv};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::{Conv2d, ConvTranspose2d};

/// Names of the checkpoint that are not those of fields.
pub const RENAMES: [(&str, &str); 6] = [
    (r"\.resConfUnit([12])\.", ".unit$1."),
    (r"\.resize_layers\.0\.", ".resize_layers.four_times."),
    (r"\.resize_layers\.1\.", ".resize_layers.twice."),
    (r"\.resize_layers\.3\.", ".resize_layers.half."),
    (r"\.output_conv2\.0\.", ".output_conv2.wide."),
    (r"\.output_conv2\.2\.", ".output_conv2.last."),
];

/// Channels of the fused levels, and of the four maps.
fn channels(size: BackboneSize) -> (usize, [usize; 4]) {
    match size {
        BackboneSize::Small => (64, [48, 96, 192, 384]),
        BackboneSize::Base => (128, [96, 192, 384, 768]),
        BackboneSize::Large => (256, [256, 512, 1024, 1024]),
    }
}

/// Channels before the last convolution.
const LAST: usize = 32;

#[derive(Module, Debug)]
pub struct DepthHead {
    projects: [Conv2d; 4],
    resize_layers: ResizeLayers,
    scratch: Scratch,
}

/// What brings the maps to their sizes. Named `0`, `1` and `3` in the checkpoint; `2` would change
/// nothing.
#[derive(Module, Debug)]
struct ResizeLayers {
    four_times: ConvTranspose2d,
    twice: ConvTranspose2d,
    half: Conv2d,
}

#[derive(Module, Debug)]
struct Scratch {
    layer1_rn: Conv2d,
    layer2_rn: Conv2d,
    layer3_rn: Conv2d,
    layer4_rn: Conv2d,
    refinenet1: Fusion,
    refinenet2: Fusion,
    refinenet3: Fusion,
    refinenet4: Fusion,
    output_conv1: Conv2d,
    output_conv2: Output,
}

/// Named `0` and `2` in the checkpoint.
#[derive(Module, Debug)]
struct Output {
    wide: Conv2d,
    last: Conv2d,
}

/// A level and what comes from the coarser ones. The coarsest has no use for `unit1`.
#[derive(Module, Debug)]
struct Fusion {
    out_conv: Conv2d,
    unit1: Residual,
    unit2: Residual,
}

#[derive(Module, Debug)]
struct Residual {
    conv1: Conv2d,
    conv2: Conv2d,
}

impl Residual {
    fn new(width: usize, device: &Device) -> Self {
        let square = || conv([width, width], 3, 1, true, device);
        Self {
            conv1: square(),
            conv2: square(),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = convolve([relu(x.clone())], &self.conv1);
        convolve([relu(y)], &self.conv2) + x
    }
}

impl Fusion {
    fn new(width: usize, device: &Device) -> Self {
        Self {
            out_conv: conv([width, width], 1, 1, true, device),
            unit1: Residual::new(width, device),
            unit2: Residual::new(width, device),
        }
    }

    /// `coarse` with the level `here` (which the coarsest has not), in the size `to`, rows and
    /// columns.
    fn forward(&self, coarse: Tensor<4>, here: Option<Tensor<4>>, to: [usize; 2]) -> Tensor<4> {
        let x = match here {
            Some(here) => coarse + self.unit1.forward(here),
            None => coarse,
        };
        // a convolution of single pixels and a mean of pixels may change places: the smaller map is
        // convolved
        interpolated(convolve([self.unit2.forward(x)], &self.out_conv), to, true)
    }
}

impl DepthHead {
    pub fn new(size: BackboneSize, device: &Device) -> Self {
        let (f, maps) = channels(size);
        let level = |i: usize| conv([maps[i], f], 3, 1, false, device);
        Self {
            projects: maps.map(|to| conv([size.width(), to], 1, 1, true, device)),
            resize_layers: ResizeLayers {
                four_times: upscaling_conv([maps[0]; 2], 4, device),
                twice: upscaling_conv([maps[1]; 2], 2, device),
                half: conv([maps[3], maps[3]], 3, 2, true, device),
            },
            scratch: Scratch {
                layer1_rn: level(0),
                layer2_rn: level(1),
                layer3_rn: level(2),
                layer4_rn: level(3),
                refinenet1: Fusion::new(f, device),
                refinenet2: Fusion::new(f, device),
                refinenet3: Fusion::new(f, device),
                refinenet4: Fusion::new(f, device),
                output_conv1: conv([f, f / 2], 3, 1, true, device),
                output_conv2: Output {
                    wide: conv([f / 2, LAST], 3, 1, true, device),
                    last: conv([LAST, 1], 1, 1, true, device),
                },
            },
        }
    }

    /// Of four maps of `grid` patches (rows, columns): `[b, 1, 14 h, 14 w]`.
    pub fn forward(&self, maps: [Tap; 4], grid: [usize; 2]) -> Tensor<4> {
        let [_, _, _, finest] = self.fused(self.levels(maps, grid));
        let x = convolve([finest], &self.scratch.output_conv1);
        let x = interpolated(x, grid.map(|side| side * PATCH), true);
        let output = &self.scratch.output_conv2;
        convolve([relu(convolve([x], &output.wide))], &output.last)
    }

    /// The maps at their sizes, from fine to coarse, all with the same channels.
    fn levels(&self, maps: [Tap; 4], [h, w]: [usize; 2]) -> [Tensor<4>; 4] {
        let projected = |i: usize| {
            let map = maps[i].patches.clone();
            let [b, _, c] = map.dims();
            self.projects[i].forward(map.swap_dims(1, 2).reshape([b, c, h, w]))
        };
        let (layers, scratch) = (&self.resize_layers, &self.scratch);
        [
            convolve(
                [layers.four_times.forward(projected(0))],
                &scratch.layer1_rn,
            ),
            convolve([layers.twice.forward(projected(1))], &scratch.layer2_rn),
            convolve([projected(2)], &scratch.layer3_rn),
            convolve([layers.half.forward(projected(3))], &scratch.layer4_rn),
        ]
    }

    /// Each of `levels` with those coarser than it, from coarse to fine, in the size of the next;
    /// the last in twice its own.
    fn fused(&self, levels: [Tensor<4>; 4]) -> [Tensor<4>; 4] {
        let size = |x: &Tensor<4>| {
            let [_, _, h, w] = x.dims();
            [h, w]
        };
        let [level1, level2, level3, level4] = levels;
        let net = &self.scratch;
        let path4 = net.refinenet4.forward(level4, None, size(&level3));
        let to = size(&level2);
        let path3 = net.refinenet3.forward(path4.clone(), Some(level3), to);
        let to = size(&level1);
        let path2 = net.refinenet2.forward(path3.clone(), Some(level2), to);
        let to = to.map(|side| 2 * side);
        let path1 = net.refinenet1.forward(path2.clone(), Some(level1), to);
        [path4, path3, path2, path1]
    }
}

#[cfg(test)]
impl DepthHead {
    pub fn coarse_paths(&self, maps: [Tap; 4], grid: [usize; 2]) -> [Tensor<4>; 2] {
        let [path4, path3, _, _] = self.fused(self.levels(maps, grid));
        [path4, path3]
    }
}
