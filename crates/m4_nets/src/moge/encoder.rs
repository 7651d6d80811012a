//! The backbone, and its tapped blocks as one map.

use crate::dinov2::{BackboneSize, DinoV2};
use crate::ops::conv;
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{Device, Tensor};
use burn_nn::Initializer;
use burn_nn::conv::Conv2d;

/// The encoder.
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

    /// Of images `[b, 3, 14 h, 14 w]` from 0 to 1: the map `[b, c, h, w]`, and the class token of the last tap, `[b, c']`.
    pub fn forward(&self, images: Tensor<4>, taps: &[usize], [h, w]: [usize; 2]) -> (Tensor<4>, Tensor<2>) {
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
