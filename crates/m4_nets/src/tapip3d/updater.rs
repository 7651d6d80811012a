//! Steps of tracks, from what is seen around them: attention over time a track, and among tracks through a few virtual ones
//! (CoTracker3's `EfficientUpdateFormer`).

use super::layers::{CrossBlock, SelfBlock};
use super::sizes::Sizes;
use crate::ops::{linear, zeros};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{Device, Tensor};
use burn_nn::Linear;

/// The updater. Named `point_updater` in the checkpoint, where `virtual_tracks` is `virual_tracks`.
#[derive(Module, Debug)]
pub struct Updater {
    virtual_tracks: Param<Tensor<4>>,
    input_transform: Linear,
    flow_head: Linear,
    time_blocks: Vec<SelfBlock>,
    space_virtual_blocks: Vec<SelfBlock>,
    space_point2virtual_blocks: Vec<CrossBlock>,
    space_virtual2point_blocks: Vec<CrossBlock>,
}

impl Updater {
    pub fn new(sizes: &Sizes, heads: usize, device: &Device) -> Self {
        let (width, hidden) = (sizes.hidden, sizes.hidden_hidden);
        let alone = |n: usize| (0..n).map(|_| SelfBlock::new(width, hidden, heads, device)).collect();
        let cross = |n: usize| (0..n).map(|_| CrossBlock::new(width, width, hidden, heads, device)).collect();
        Self {
            virtual_tracks: zeros([1, sizes.virtual_tracks, 1, width], device),
            input_transform: linear(sizes.input, width, true, device),
            flow_head: linear(width, sizes.output, true, device),
            time_blocks: alone(sizes.time_depth),
            space_virtual_blocks: alone(sizes.space_depth),
            space_point2virtual_blocks: cross(sizes.space_depth),
            space_virtual2point_blocks: cross(sizes.space_depth),
        }
    }

    /// Of `x` `[frames, tracks, input]`: `[frames, tracks, output]`.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let [frames, tracks, input] = x.dims();
        let points = self.input_transform.forward(x.reshape([frames * tracks, input]));
        let [_, width] = points.dims();
        let points = points.reshape([frames, tracks, width]);
        let [_, more, _, _] = self.virtual_tracks.dims();
        let virtual_tracks = self.virtual_tracks.val().reshape([1, more, width]);
        // [frames, tracks, then virtual tracks, width]
        let mut tokens = Tensor::cat(vec![points, virtual_tracks.expand([frames, more, width])], 1);
        let every = self.time_blocks.len() / self.space_virtual_blocks.len().max(1);
        let mut space = self
            .space_virtual2point_blocks
            .iter()
            .zip(&self.space_virtual_blocks)
            .zip(&self.space_point2virtual_blocks);
        for (i, block) in self.time_blocks.iter().enumerate() {
            tokens = block.forward(tokens.swap_dims(0, 1)).swap_dims(0, 1);
            if i % every.max(1) != 0 {
                continue;
            }
            let Some(((gather, among, spread), points, virtual_tracks)) =
                space.next().map(|((gather, among), spread)| {
                    let points = tokens.clone().narrow(1, 0, tracks);
                    ((gather, among, spread), points, tokens.clone().narrow(1, tracks, more))
                })
            else {
                continue;
            };
            let virtual_tracks = among.forward(gather.forward(virtual_tracks, points.clone()));
            let points = spread.forward(points, virtual_tracks.clone());
            tokens = Tensor::cat(vec![points, virtual_tracks], 1);
        }
        let points = tokens.narrow(1, 0, tracks).reshape([frames * tracks, width]);
        let out = self.flow_head.forward(points);
        let [_, to] = out.dims();
        out.reshape([frames, tracks, to])
    }
}
