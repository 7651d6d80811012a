//! Steps of tracks, from what is seen around them: attention over time a track, and among tracks
//! through a few virtual ones (CoTracker3's `EfficientUpdateFormer`).

use super::config::Sizes;
use super::encoding::{encoded, width};
use super::layers::{Attention, CrossBlock, KeysValues, Pooling, SelfBlock};
use crate::ops::{gelu, linear, norm, zeros};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::{Device, Tensor};
use burn_nn::{LayerNorm, Linear};

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
        let alone = |n: usize| {
            (0..n)
                .map(|_| SelfBlock::new(width, hidden, heads, device))
                .collect()
        };
        let cross = |n: usize| {
            (0..n)
                .map(|_| CrossBlock::new(width, width, hidden, heads, device))
                .collect()
        };
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
        let points = self
            .input_transform
            .forward(x.reshape([frames * tracks, input]));
        let [_, width] = points.dims();
        let points = points.reshape([frames, tracks, width]);
        let [_, more, _, _] = self.virtual_tracks.dims();
        let virtual_tracks = self.virtual_tracks.val().reshape([1, more, width]);
        // [frames, tracks, then virtual tracks, width]
        let mut tokens = Tensor::cat(
            vec![points, virtual_tracks.expand([frames, more, width])],
            1,
        );
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
                    (
                        (gather, among, spread),
                        points,
                        tokens.clone().narrow(1, tracks, more),
                    )
                })
            else {
                continue;
            };
            let virtual_tracks = among.forward(gather.forward(virtual_tracks, points.clone()));
            let points = spread.forward(points, virtual_tracks.clone());
            tokens = Tensor::cat(vec![points, virtual_tracks], 1);
        }
        let points = tokens
            .narrow(1, 0, tracks)
            .reshape([frames * tracks, width]);
        let out = self.flow_head.forward(points);
        let [_, to] = out.dims();
        out.reshape([frames, tracks, to])
    }
}

/// Layers that encode offsets. Named `0`, `1`, `3`, `5` in the checkpoint.
#[derive(Module, Debug)]
struct OffsetEncoder {
    norm_in: LayerNorm,
    hidden: Linear,
    out: Linear,
    norm_out: LayerNorm,
}

impl OffsetEncoder {
    fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        let x = gelu(self.hidden.forward(self.norm_in.forward(x)));
        self.norm_out.forward(gelu(self.out.forward(x)))
    }
}

/// Two sets of tokens, each in the light of the other.
#[derive(Module, Debug)]
struct Meeting {
    output_token_1: Param<Tensor<2>>,
    output_token_2: Param<Tensor<2>>,
    xblock1_2: CrossBlock,
    xblock2_1: CrossBlock,
    aggr1: Attention,
    aggr2: Attention,
}

/// How a point's neighbourhood now looks like its neighbourhood when it was asked for: attention
/// between two sets of tokens, each the feature of a point of the map and the encoding of its
/// offset from the tracked point. Of both sets, each in the light of the other, a learned token
/// makes one vector; the two are added. What depends on the query alone is computed once a window,
/// and what the learned tokens ask for is multiplied into the weights before: upstream computes
/// both for every frame and iteration, which is a quarter more operations.
///
/// The layers of all levels. Named `corr_processor` in the checkpoint.
#[derive(Module, Debug)]
pub struct Correlation {
    in_norm: LayerNorm,
    posenc_mlps: Vec<OffsetEncoder>,
    transformers: Vec<Meeting>,
    feat_transform: Option<Linear>,
}

/// What a level knows of its queries in a window.
#[derive(Debug, Clone)]
pub struct QuerySide {
    /// `[queries, tokens, width]`.
    x: Tensor<3>,
    /// `[queries, heads, tokens, c]`.
    q: Tensor<4>,
    kv: KeysValues,
    pooling: [Pooling; 2],
}

impl QuerySide {
    /// That of the `n` queries from `first` on.
    pub fn some(&self, first: usize, n: usize) -> Self {
        let some = |x: &Tensor<4>| x.clone().narrow(0, first, n);
        Self {
            x: self.x.clone().narrow(0, first, n),
            q: some(&self.q),
            kv: KeysValues(some(&self.kv.0), some(&self.kv.1)),
            pooling: self.pooling.clone(),
        }
    }
}

impl Correlation {
    pub fn new(sizes: &Sizes, heads: usize, device: &Device) -> Self {
        let (tokens, inner) = (sizes.tokens, sizes.token_heads);
        let block = || CrossBlock::new(tokens, inner, sizes.tokens_hidden, heads, device);
        let pool = || Attention::new(tokens, inner, heads, false, device);
        let offsets = |_| OffsetEncoder {
            norm_in: norm(width(3), device),
            hidden: linear(width(3), sizes.offsets_hidden, true, device),
            out: linear(sizes.offsets_hidden, tokens, true, device),
            norm_out: norm(tokens, device),
        };
        let meeting = |_| Meeting {
            output_token_1: zeros([1, tokens], device),
            output_token_2: zeros([1, tokens], device),
            xblock1_2: block(),
            xblock2_1: block(),
            aggr1: pool(),
            aggr2: pool(),
        };
        Self {
            in_norm: norm(sizes.features, device),
            posenc_mlps: (0..sizes.sets).map(offsets).collect(),
            transformers: (0..sizes.sets).map(meeting).collect(),
            feat_transform: (tokens != sizes.features)
                .then(|| linear(sizes.features, tokens, true, device)),
        }
    }

    /// Features `[n, features]` as tokens have them, `[n, width]`.
    pub fn prepared(&self, features: Tensor<2>) -> Tensor<2> {
        let x = self.in_norm.forward(features);
        match &self.feat_transform {
            Some(transform) => transform.forward(x),
            None => x,
        }
    }

    fn offsets(&self, level: usize, offsets: &[[f32; 3]], like: &Tensor<3>) -> Tensor<3> {
        let x = encoded(offsets, &like.device(), like.dtype());
        self.posenc_mlps[level].forward(x).reshape(like.dims())
    }

    /// The query side of `level`: prepared features `[queries, tokens, width]`, and where they are
    /// from the query, `[queries][tokens]`.
    pub fn query_side(&self, level: usize, features: Tensor<3>, offsets: &[[f32; 3]]) -> QuerySide {
        let meeting = &self.transformers[level];
        let x = self.offsets(level, offsets, &features) + features;
        QuerySide {
            q: meeting.xblock1_2.queries(x.clone()),
            kv: meeting.xblock2_1.context(x.clone()),
            x,
            pooling: [
                meeting.aggr1.pooling(meeting.output_token_1.val()),
                meeting.aggr2.pooling(meeting.output_token_2.val()),
            ],
        }
    }

    /// How neighbourhoods compare: `side` with those whose prepared features are `features`
    /// `[frames * queries, neighbours, width]`, and `offsets` `[frames][queries][neighbours]` from
    /// the points that are followed. `[frames * queries, width]`.
    pub fn forward(
        &self,
        level: usize,
        side: &QuerySide,
        features: Tensor<3>,
        offsets: &[[f32; 3]],
    ) -> Tensor<2> {
        let meeting = &self.transformers[level];
        let y = self.offsets(level, offsets, &features) + features;
        let [queries, tokens, width] = side.x.dims();
        let frames = y.dims()[0] / queries.max(1);
        let again = |x: &Tensor<4>| {
            let [n, h, m, c] = x.dims();
            x.clone()
                .unsqueeze_dim::<5>(0)
                .expand([frames, n, h, m, c])
                .reshape([frames * n, h, m, c])
        };
        let x = side
            .x
            .clone()
            .unsqueeze_dim::<4>(0)
            .expand([frames, queries, tokens, width]);
        let x = x.reshape([frames * queries, tokens, width]);
        let others = meeting.xblock1_2.context(y.clone());
        let x = meeting.xblock1_2.revised(x, again(&side.q), others);
        let q = meeting.xblock2_1.queries(y.clone());
        let kv = KeysValues(again(&side.kv.0), again(&side.kv.1));
        let y = meeting.xblock2_1.revised(y, q, kv);
        side.pooling[0].forward(x) + side.pooling[1].forward(y)
    }
}
