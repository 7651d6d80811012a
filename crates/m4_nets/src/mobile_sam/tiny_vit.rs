//! The image encoder, TinyViT (Wu et al., "TinyViT: Fast Pretraining Distillation for Small Vision
//! Transformers", ECCV 2022) as MobileSAM trains it: of 1024 x 1024 pixels, 256 channels at 1/16.
//!
//! ```text
//! 1024 --two convolutions--> 256 --two MBConv--> merge --> 128 --2 blocks--> merge --> 64 --6 blocks--> merge --2 blocks--> neck
//! ```

use crate::ops::{
    Statistics, conv, fine_norm, gelu, in_parts, linear, norm, over_channels, softmax_rows, zeros,
};
use crate::sam::{cut, joined};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::module::conv2d;
use burn_core::tensor::ops::ConvOptions;
use burn_core::tensor::{Device, Int, Tensor, TensorData};
use burn_nn::conv::Conv2d;
use burn_nn::{LayerNorm, Linear};

const WIDTHS: [usize; 4] = [64, 128, 160, 320];
/// Channels of a head of attention.
const HEAD: usize = 32;
/// Channels of the embedding.
const EMBEDDING: usize = 256;

/// Three convolutions with a wide middle beside a shortcut.
#[derive(Module, Debug)]
pub struct MbConv {
    conv1: ConvBn,
    conv2: ConvBn,
    conv3: ConvBn,
}

impl MbConv {
    fn new(width: usize, device: &Device) -> Self {
        Self {
            conv1: ConvBn::new([width, 4 * width], 1, 1, device),
            conv2: ConvBn::depthwise(4 * width, 1, device),
            conv3: ConvBn::new([4 * width, width], 1, 1, device),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = gelu(self.conv1.forward(x.clone()));
        let y = gelu(self.conv2.forward(y));
        gelu(self.conv3.forward(y) + x)
    }
}

/// From one stage to the next: other channels, and half the size unless `stride` is 1.
#[derive(Module, Debug)]
pub struct Merge {
    conv1: ConvBn,
    conv2: ConvBn,
    conv3: ConvBn,
}

impl Merge {
    fn new([from, to]: [usize; 2], stride: usize, device: &Device) -> Self {
        Self {
            conv1: ConvBn::new([from, to], 1, 1, device),
            conv2: ConvBn::depthwise(to, stride, device),
            conv3: ConvBn::new([to, to], 1, 1, device),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let x = gelu(self.conv1.forward(x));
        let x = gelu(self.conv2.forward(x));
        self.conv3.forward(x)
    }
}

#[derive(Module, Debug)]
pub struct Mlp {
    norm: LayerNorm,
    fc1: Linear,
    fc2: Linear,
}

/// Pixels that the feed-forward layer takes at a time.
const MLP_PIXELS: usize = 1024;

impl Mlp {
    /// Of `[pixels, c]`: the same shape, to be added to it.
    fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        in_parts(x, 0, MLP_PIXELS, |x| {
            self.fc2
                .forward(gelu(self.fc1.forward(self.norm.forward(x))))
        })
    }
}

/// Attention within windows, a convolution of each channel, the feed-forward layer.
#[derive(Module, Debug)]
pub struct Block {
    attn: Windowed,
    local_conv: ConvBn,
    mlp: Mlp,
}

impl Block {
    fn new(width: usize, window: usize, device: &Device) -> Self {
        Self {
            attn: Windowed::new(width, width / HEAD, window, device),
            local_conv: ConvBn::depthwise(width, 1, device),
            mlp: Mlp {
                norm: norm(width, device),
                fc1: linear(width, 4 * width, true, device),
                fc2: linear(4 * width, width, true, device),
            },
        }
    }

    /// Of `[1, c, h, w]`: the same shape.
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let [_, c, h, w] = x.dims();
        let pixels = x.permute([0, 2, 3, 1]);
        let pixels = pixels.clone() + self.attn.forward(pixels);
        let x = self.local_conv.forward(pixels.permute([0, 3, 1, 2]));
        let pixels = x.permute([0, 2, 3, 1]).reshape([h * w, c]);
        let pixels = pixels.clone() + self.mlp.forward(pixels);
        pixels.reshape([1, h, w, c]).permute([0, 3, 1, 2])
    }
}

#[derive(Module, Debug)]
pub struct Convolutions {
    blocks: [MbConv; 2],
    downsample: Merge,
}

/// A later stage, of `N` blocks.
#[derive(Module, Debug)]
pub struct Stage<const N: usize> {
    blocks: [Block; N],
    downsample: Option<Merge>,
}

impl<const N: usize> Stage<N> {
    fn new(width: usize, window: usize, downsample: Option<Merge>, device: &Device) -> Self {
        Self {
            blocks: std::array::from_fn(|_| Block::new(width, window, device)),
            downsample,
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let x = self.blocks.iter().fold(x, |x, block| block.forward(x));
        match &self.downsample {
            Some(merge) => merge.forward(x),
            None => x,
        }
    }
}

/// The first two convolutions. Named `0` and `2` in the checkpoint.
#[derive(Module, Debug)]
pub struct Stem {
    first: ConvBn,
    second: ConvBn,
}

/// To the channels of the embedding. Named `0` to `3` in the checkpoint.
#[derive(Module, Debug)]
pub struct Neck {
    flat: Conv2d,
    norm1: LayerNorm,
    wide: Conv2d,
    norm2: LayerNorm,
}

/// The encoder. The stages are named `layers.0` to `layers.3` in the checkpoint.
#[derive(Module, Debug)]
pub struct TinyVit {
    patch_embed: Stem,
    stage0: Convolutions,
    stage1: Stage<2>,
    stage2: Stage<6>,
    stage3: Stage<2>,
    neck: Neck,
}

impl TinyVit {
    pub fn new(device: &Device) -> Self {
        let [a, b, c, d] = WIDTHS;
        Self {
            patch_embed: Stem {
                first: ConvBn::new([3, a / 2], 3, 2, device),
                second: ConvBn::new([a / 2, a], 3, 2, device),
            },
            stage0: Convolutions {
                blocks: std::array::from_fn(|_| MbConv::new(a, device)),
                downsample: Merge::new([a, b], 2, device),
            },
            stage1: Stage::new(b, 7, Some(Merge::new([b, c], 2, device)), device),
            stage2: Stage::new(c, 14, Some(Merge::new([c, d], 1, device)), device),
            stage3: Stage::new(d, 7, None, device),
            neck: Neck {
                flat: conv([d, EMBEDDING], 1, 1, false, device),
                norm1: fine_norm(EMBEDDING, device),
                wide: conv([EMBEDDING, EMBEDDING], 3, 1, false, device),
                norm2: fine_norm(EMBEDDING, device),
            },
        }
    }

    /// Of an image `[1, 3, 1024, 1024]`: `[1, 256, 64, 64]`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let x = gelu(self.patch_embed.first.forward(x));
        let x = self.patch_embed.second.forward(x);
        let x = self
            .stage0
            .blocks
            .iter()
            .fold(x, |x, block| block.forward(x));
        let x = self.stage0.downsample.forward(x);
        let x = self
            .stage3
            .forward(self.stage2.forward(self.stage1.forward(x)));
        let x = over_channels(&self.neck.norm1, self.neck.flat.forward(x));
        over_channels(&self.neck.norm2, self.neck.wide.forward(x))
    }
}

/// Attention within windows of `window` by `window` pixels.
#[derive(Module, Debug)]
pub struct Windowed {
    norm: LayerNorm,
    qkv: Linear,
    proj: Linear,
    /// `[heads, window^2]`: what is added to a score, at `|dy| window + |dx|`.
    attention_biases: Param<Tensor<2>>,
    window: usize,
}

impl Windowed {
    pub fn new(width: usize, heads: usize, window: usize, device: &Device) -> Self {
        Self {
            norm: norm(width, device),
            qkv: linear(width, 3 * width, true, device),
            proj: linear(width, width, true, device),
            attention_biases: zeros([heads, window * window], device),
            window,
        }
    }

    /// Of `[1, h, w, c]`: the same shape, to be added to it. Beyond the map lie zeros, which take
    /// part as pixels.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let [_, h, w, c] = x.dims();
        let side = self.window;
        let windows = cut(x, side);
        let [n, _, _, _] = windows.dims();
        let attention = self.within(windows.reshape([n, side * side, c]));
        joined(attention.reshape([n, side, side, c]), 1, [h, w])
    }

    /// Of windows `[n, l, c]`: the same shape.
    fn within(&self, x: Tensor<3>) -> Tensor<3> {
        let [n, l, c] = x.dims();
        let [count, _] = self.attention_biases.dims();
        let width = c / count;
        let qkv = self
            .qkv
            .forward(self.norm.forward(x))
            .reshape([n, l, count, 3 * width])
            .swap_dims(1, 2);
        let [q, k, v] = [0, 1, 2].map(|i| qkv.clone().narrow(3, i * width, width));
        let scores = q
            .mul_scalar(1.0 / (width as f32).sqrt())
            .matmul(k.swap_dims(2, 3))
            + self.biases();
        let attention = softmax_rows(scores).matmul(v);
        self.proj
            .forward(attention.swap_dims(1, 2).reshape([n, l, c]))
    }

    /// What is added to the scores, `[1, heads, window^2, window^2]`.
    fn biases(&self) -> Tensor<4> {
        let biases = self.attention_biases.val();
        let [count, l] = biases.dims();
        let side = self.window;
        let distance = |a: usize, b: usize| {
            (a / side).abs_diff(b / side) * side + (a % side).abs_diff(b % side)
        };
        let at: Vec<i32> = (0..l * l).map(|i| distance(i / l, i % l) as i32).collect();
        let at = Tensor::<1, Int>::from_data(TensorData::new(at, [l * l]), &biases.device());
        biases.select(1, at).reshape([1, count, l, l])
    }
}

/// A convolution and a batch normalisation after it, which is of the statistics of training: one
/// convolution.
#[derive(Module, Debug)]
pub struct ConvBn {
    /// The kernel, `[out, in / groups, k, k]`.
    c: Param<Tensor<4>>,
    bn: Statistics,
    stride: usize,
    groups: usize,
}

impl ConvBn {
    /// Of `[from, to]` channels, with a kernel of `size` by `size`, padded by half of that.
    pub fn new([from, to]: [usize; 2], size: usize, stride: usize, device: &Device) -> Self {
        Self::grouped([from, to], size, stride, 1, device)
    }

    /// 3 by 3, each of `width` channels by itself.
    pub fn depthwise(width: usize, stride: usize, device: &Device) -> Self {
        Self::grouped([width, width], 3, stride, width, device)
    }

    fn grouped(
        [from, to]: [usize; 2],
        size: usize,
        stride: usize,
        groups: usize,
        device: &Device,
    ) -> Self {
        Self {
            c: zeros([to, from / groups, size, size], device),
            bn: Statistics::new(to, device),
            stride,
            groups,
        }
    }

    /// Of `[n, from, h, w]`: `[n, to, h / stride, w / stride]`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let (kernel, bias) = self.bn.after(self.c.val(), None);
        let [_, _, size, _] = kernel.dims();
        let pad = [size / 2, size / 2];
        let options = ConvOptions::new([self.stride, self.stride], pad, [1, 1], self.groups);
        conv2d(x, kernel, Some(bias), options)
    }
}
