//! A frame's features in the light of what is remembered: four layers of attention among the
//! pixels, attention to memories, and a feed-forward layer.
//!
//! Attention to memories weighs the memories as they are, in 64 channels, and projects to 256 what
//! comes out, where upstream projects each memory before: the same but for rounding, as weights sum
//! to one, for a quarter of the operations.

use super::hiera::Pointwise;
use crate::ops::{ConvNext, attend_heads, conv, fine_norm, gelu, in_parts, linear, norm, tensor};
use crate::sam::{Attention, WIDTH};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::activation::relu;
use burn_core::tensor::{DType, Device, Int, Tensor, TensorData};
use burn_nn::conv::Conv2d;
use burn_nn::{LayerNorm, Linear};

/// Channels of memories.
pub const MEMORY_WIDTH: usize = 64;
const LAYERS: usize = 4;
const MLP_WIDTH: usize = 2048;
/// Pixels that the feed-forward layer takes at a time.
const MLP_PIXELS: usize = 512;

/// What is attended to.
#[derive(Debug, Clone)]
pub struct Memories {
    /// `[b, m, 64]`.
    pub values: Tensor<3>,
    /// The same with their positions.
    pub keys: Tensor<3>,
    /// How many of them, the first, are pixels of whole maps; those after them have no place.
    pub placed: usize,
}

/// With one head.
impl Attention {
    /// As [`Rotations`] takes queries and keys.
    fn arranged(self) -> Self {
        Self {
            q_proj: halves_apart(self.q_proj),
            k_proj: halves_apart(self.k_proj),
            ..self
        }
    }

    /// Of the pixels `x` `[b, n, 256]` among themselves.
    pub fn among(&self, x: Tensor<3>, rotations: &Rotations) -> Tensor<3> {
        let q = rotations.turn(self.q_proj.forward(x.clone()));
        let k = rotations.turn(self.k_proj.forward(x.clone()));
        let v = self.v_proj.forward(x);
        self.out_proj.forward(of_one_head(q, k, v))
    }

    /// Of the pixels `x`, `[b, n, 256]` or one for all `b`, to memories.
    pub fn to(&self, x: Tensor<3>, memories: &Memories, rotations: &Rotations) -> Tensor<3> {
        let [b, m, _] = memories.keys.dims();
        let [_, n, c] = x.dims();
        let q = rotations.turn(self.q_proj.forward(x)).expand([b, n, c]);
        let keys = self.k_proj.forward(memories.keys.clone());
        let placed = memories.placed;
        let mut parts = Vec::new();
        if placed > 0 {
            parts.push(rotations.turn(keys.clone().narrow(1, 0, placed)));
        }
        if m > placed {
            parts.push(keys.narrow(1, placed, m - placed));
        }
        let attention = of_one_head(q, Tensor::cat(parts, 1), memories.values.clone());
        self.out_proj.forward(self.v_proj.forward(attention))
    }
}

fn of_one_head(q: Tensor<3>, k: Tensor<3>, v: Tensor<3>) -> Tensor<3> {
    attend_heads(q.unsqueeze_dim(1), k.unsqueeze_dim(1), v.unsqueeze_dim(1)).squeeze_dim(1)
}

#[derive(Module, Debug)]
pub struct Layer {
    /// Among pixels.
    pub self_attn: Attention,
    /// To memories.
    pub cross_attn_image: Attention,
    linear1: Linear,
    linear2: Linear,
    norm1: LayerNorm,
    norm2: LayerNorm,
    norm3: LayerNorm,
}

impl Layer {
    fn new(device: &Device) -> Self {
        Self {
            self_attn: Attention::new(WIDTH, WIDTH, device),
            cross_attn_image: Attention::new(MEMORY_WIDTH, WIDTH, device),
            linear1: linear(WIDTH, MLP_WIDTH, true, device),
            linear2: linear(MLP_WIDTH, WIDTH, true, device),
            norm1: norm(WIDTH, device),
            norm2: norm(WIDTH, device),
            norm3: norm(WIDTH, device),
        }
    }

    fn among(&self, x: Tensor<3>, rotations: &Rotations) -> Tensor<3> {
        x.clone() + self.self_attn.among(self.norm1.forward(x), rotations)
    }

    fn to(&self, x: Tensor<3>, memories: &Memories, rotations: &Rotations) -> Tensor<3> {
        x.clone()
            + self
                .cross_attn_image
                .to(self.norm2.forward(x), memories, rotations)
    }

    fn feed(&self, x: Tensor<3>) -> Tensor<3> {
        let normal = self.norm3.forward(x.clone());
        x + in_parts(normal, 1, MLP_PIXELS, |x| {
            self.linear2.forward(relu(self.linear1.forward(x)))
        })
    }
}

#[derive(Module, Debug)]
pub struct MemoryAttention {
    pub layers: [Layer; LAYERS],
    norm: LayerNorm,
}

impl MemoryAttention {
    pub fn new(device: &Device) -> Self {
        Self {
            layers: std::array::from_fn(|_| Layer::new(device)),
            norm: norm(WIDTH, device),
        }
    }

    /// As [`Rotations`] takes queries and keys: once, after loading.
    pub fn arranged(self) -> Self {
        Self {
            layers: self.layers.map(|layer| Layer {
                self_attn: layer.self_attn.arranged(),
                cross_attn_image: layer.cross_attn_image.arranged(),
                ..layer
            }),
            norm: self.norm,
        }
    }

    /// What depends on the frame alone: its features `map` `[1, n, 256]`, whose places are
    /// `places`, after the first layer's attention among themselves.
    pub fn begun(&self, map: Tensor<3>, places: &Tensor<3>, rotations: &Rotations) -> Tensor<3> {
        let [first, ..] = &self.layers;
        first.among(map + places.clone().mul_scalar(0.1), rotations)
    }

    /// What is [`begun`](Self::begun), `[1, n, 256]`, in the light of `b` sets of memories:
    /// `[b, n, 256]`.
    pub fn forward(
        &self,
        begun: Tensor<3>,
        memories: &Memories,
        rotations: &Rotations,
    ) -> Tensor<3> {
        let mut x = begun;
        for (i, layer) in self.layers.iter().enumerate() {
            if i > 0 {
                x = layer.among(x, rotations);
            }
            x = layer.feed(layer.to(x, memories, rotations));
        }
        self.norm.forward(x)
    }
}

/// Pairs of channels.
const PAIRS: usize = WIDTH / 2;
/// The wavelengths' ratio, all together.
const THETA: f32 = 10_000.0;

/// Positions as rotations: channels in pairs, each rotated by its own angle per column or row (Su
/// et al., "RoFormer", 2021; in two directions as Heo et al., "Rotary Position Embedding for Vision
/// Transformer", ECCV 2024). Upstream rotates neighbouring channels as one complex number. Here the
/// first channels of all pairs come before the second ones: scores do not depend on the order of
/// channels, so the layers that make queries and keys are [reordered](halves_apart) once, and a
/// rotation reads whole rows.
///
/// Cosines and sines of a square map, `[1, 1, n, 128]` each.
#[derive(Debug, Clone)]
pub struct Rotations {
    cos: Tensor<4>,
    sin: Tensor<4>,
}

impl Rotations {
    /// Of a map of `side` rows and columns.
    pub fn new(side: usize, device: &Device, dtype: DType) -> Self {
        let frequency = |i: usize| 1.0 / THETA.powf((4 * i) as f32 / WIDTH as f32);
        let angle = |i: usize| {
            let (at, pair) = (i / PAIRS, i % PAIRS);
            let half = PAIRS / 2;
            let steps = if pair < half { at % side } else { at / side };
            steps as f32 * frequency(pair % half)
        };
        let angles: Vec<f32> = (0..side * side * PAIRS).map(angle).collect();
        let table = |f: fn(f32) -> f32| {
            let values = angles.iter().map(|&a| f(a)).collect();
            tensor(values, [1, 1, side * side, PAIRS], device).cast(dtype)
        };
        Self {
            cos: table(f32::cos),
            sin: table(f32::sin),
        }
    }

    /// Places of a map.
    fn places(&self) -> usize {
        self.cos.dims()[2]
    }

    /// `x` `[b, r n, 256]`, some maps one after the other, turned.
    pub fn turn(&self, x: Tensor<3>) -> Tensor<3> {
        let [b, m, c] = x.dims();
        let n = self.places();
        let x = x.reshape([b, m / n, n, c]);
        let (first, second) = (x.clone().narrow(3, 0, PAIRS), x.narrow(3, PAIRS, PAIRS));
        let along = first.clone() * self.cos.clone() - second.clone() * self.sin.clone();
        let across = first * self.sin.clone() + second * self.cos.clone();
        Tensor::cat(vec![along, across], 3).reshape([b, m, c])
    }
}

/// `layer`, whose outputs are pairs of channels, with all first ones before all second ones.
pub fn halves_apart(layer: Linear) -> Linear {
    let order: Vec<i32> = (0..2)
        .flat_map(|k| (0..PAIRS as i32).map(move |i| 2 * i + k))
        .collect();
    let order = Tensor::<1, Int>::from_data(
        TensorData::new(order, [WIDTH]),
        &layer.weight.val().device(),
    );
    Linear {
        weight: Param::from_tensor(layer.weight.val().select(1, order.clone())),
        bias: layer
            .bias
            .map(|bias| Param::from_tensor(bias.val().select(0, order))),
    }
}

/// Channels of the mask, from its own size to a sixteenth.
const MASK_WIDTHS: [usize; 5] = [1, 4, 16, 64, WIDTH];

/// A mask as features. Named `encoder.0`, `3`, `6`, `9` and `1`, `4`, `7`, `10`, and `12` in the
/// checkpoint.
#[derive(Module, Debug)]
pub struct MaskEncoder {
    convs: [Conv2d; 4],
    norms: [LayerNorm; 4],
    out: Conv2d,
}

impl MaskEncoder {
    fn new(device: &Device) -> Self {
        Self {
            convs: std::array::from_fn(|i| {
                conv([MASK_WIDTHS[i], MASK_WIDTHS[i + 1]], 3, 2, true, device)
            }),
            norms: std::array::from_fn(|i| fine_norm(MASK_WIDTHS[i + 1], device)),
            out: conv([WIDTH, WIDTH], 1, 1, true, device),
        }
    }

    /// Of `[b, 1, 16 h, 16 w]`: `[b, h, w, 256]`.
    pub fn forward(&self, mask: Tensor<4>) -> Tensor<4> {
        let mut x = mask.permute([0, 2, 3, 1]);
        for (conv, norm) in self.convs.iter().zip(&self.norms) {
            let smaller = conv.forward(x.permute([0, 3, 1, 2]));
            x = gelu(norm.forward(smaller.permute([0, 2, 3, 1])));
        }
        Pointwise::of(&self.out).forward(x)
    }
}

#[derive(Module, Debug)]
pub struct MemoryEncoder {
    pub mask_downsampler: MaskEncoder,
    pix_feat_proj: Conv2d,
    fuser: [ConvNext; 2],
    out_proj: Conv2d,
}

impl MemoryEncoder {
    pub fn new(device: &Device) -> Self {
        Self {
            mask_downsampler: MaskEncoder::new(device),
            pix_feat_proj: conv([WIDTH, WIDTH], 1, 1, true, device),
            fuser: std::array::from_fn(|_| ConvNext::new(WIDTH, fine_norm(WIDTH, device), device)),
            out_proj: conv([WIDTH, MEMORY_WIDTH], 1, 1, true, device),
        }
    }

    /// Of a frame's features `[1, h, w, 256]` and `b` masks `[b, 1, 16 h, 16 w]`, from -10 to 10:
    /// `[b, h, w, 64]`.
    pub fn forward(&self, map: Tensor<4>, masks: Tensor<4>) -> Tensor<4> {
        let x =
            Pointwise::of(&self.pix_feat_proj).forward(map) + self.mask_downsampler.forward(masks);
        Pointwise::of(&self.out_proj)
            .forward(self.fuser.iter().fold(x, |x, block| block.forward(x)))
    }
}
