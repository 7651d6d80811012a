//! The decoder's transformer: tokens that look at the image and an image that looks at the tokens,
//! in turn (Kirillov et al., "Segment Anything", ICCV 2023, appendix A).

use super::WIDTH;
use crate::ops::{attend_heads, fine_norm, gelu, linear, norm, upscaling_conv};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::ConvTranspose2d;
use burn_nn::{LayerNorm, Linear};

const HEADS: usize = 8;
const MLP_WIDTH: usize = 2048;

#[derive(Module, Debug)]
pub struct Attention {
    pub q_proj: Linear,
    pub k_proj: Linear,
    pub v_proj: Linear,
    pub out_proj: Linear,
}

impl Attention {
    /// To keys and values of `from` channels, in `inner` channels of all heads together.
    pub fn new(from: usize, inner: usize, device: &Device) -> Self {
        Self {
            q_proj: linear(WIDTH, inner, true, device),
            k_proj: linear(from, inner, true, device),
            v_proj: linear(from, inner, true, device),
            out_proj: linear(inner, WIDTH, true, device),
        }
    }

    /// In eight heads, of `q` `[b, n, 256]`, `k` and `v` `[b, m, 256]`: `[b, n, 256]`.
    fn forward(&self, q: Tensor<3>, k: Tensor<3>, v: Tensor<3>) -> Tensor<3> {
        let split = |x: Tensor<3>| {
            let [b, n, c] = x.dims();
            x.reshape([b, n, HEADS, c / HEADS]).swap_dims(1, 2)
        };
        let q = self.q_proj.forward(q);
        let shape = q.dims();
        let k = self.k_proj.forward(k);
        let v = self.v_proj.forward(v);
        let attention = attend_heads(split(q), split(k), split(v));
        self.out_proj
            .forward(attention.swap_dims(1, 2).reshape(shape))
    }
}

#[derive(Module, Debug)]
struct FeedForward {
    lin1: Linear,
    lin2: Linear,
}

/// Tokens among themselves, tokens to image, feed-forward, image to tokens.
#[derive(Module, Debug)]
pub struct Layer {
    self_attn: Attention,
    norm1: LayerNorm,
    cross_attn_token_to_image: Attention,
    norm2: LayerNorm,
    mlp: FeedForward,
    norm3: LayerNorm,
    norm4: LayerNorm,
    cross_attn_image_to_token: Attention,
}

impl Layer {
    fn new(device: &Device) -> Self {
        let norm = || norm(WIDTH, device);
        Self {
            self_attn: Attention::new(WIDTH, WIDTH, device),
            norm1: norm(),
            cross_attn_token_to_image: Attention::new(WIDTH, WIDTH / 2, device),
            norm2: norm(),
            mlp: FeedForward {
                lin1: linear(WIDTH, MLP_WIDTH, true, device),
                lin2: linear(MLP_WIDTH, WIDTH, true, device),
            },
            norm3: norm(),
            norm4: norm(),
            cross_attn_image_to_token: Attention::new(WIDTH, WIDTH / 2, device),
        }
    }

    /// The tokens after their attention among themselves. In the first layer, where they are
    /// `places` itself, its result takes their place.
    fn among_themselves(&self, tokens: Tensor<3>, places: &Tensor<3>, first: bool) -> Tensor<3> {
        let tokens = if first {
            self.self_attn
                .forward(tokens.clone(), tokens.clone(), tokens)
        } else {
            let placed = tokens.clone() + places.clone();
            tokens.clone() + self.self_attn.forward(placed.clone(), placed, tokens)
        };
        self.norm1.forward(tokens)
    }
}

#[derive(Module, Debug)]
pub struct TwoWay {
    layers: [Layer; 2],
    final_attn_token_to_image: Attention,
    norm_final_attn: LayerNorm,
}

impl TwoWay {
    pub fn new(device: &Device) -> Self {
        Self {
            layers: std::array::from_fn(|_| Layer::new(device)),
            final_attn_token_to_image: Attention::new(WIDTH, WIDTH / 2, device),
            norm_final_attn: norm(WIDTH, device),
        }
    }

    /// `tokens` `[b, n, 256]` and the images' `pixels` `[b, m, 256]`, whose places are `grid`
    /// `[1, m, 256]`, after each has seen the other.
    pub fn forward(
        &self,
        tokens: Tensor<3>,
        pixels: Tensor<3>,
        grid: &Tensor<3>,
    ) -> (Tensor<3>, Tensor<3>) {
        let places = tokens.clone();
        let (mut tokens, mut pixels) = (tokens, pixels);
        for (i, layer) in self.layers.iter().enumerate() {
            tokens = layer.among_themselves(tokens, &places, i == 0);
            let attention = layer.cross_attn_token_to_image.forward(
                tokens.clone() + places.clone(),
                pixels.clone() + grid.clone(),
                pixels.clone(),
            );
            tokens = layer.norm2.forward(tokens + attention);
            let wide = relu(layer.mlp.lin1.forward(tokens.clone()));
            tokens = layer.norm3.forward(tokens + layer.mlp.lin2.forward(wide));
            let attention = layer.cross_attn_image_to_token.forward(
                pixels.clone() + grid.clone(),
                tokens.clone() + places.clone(),
                tokens.clone(),
            );
            pixels = layer.norm4.forward(pixels + attention);
        }
        let attention = self.final_attn_token_to_image.forward(
            tokens.clone() + places,
            pixels.clone() + grid.clone(),
            pixels.clone(),
        );
        (self.norm_final_attn.forward(tokens + attention), pixels)
    }
}

/// Channels of the map that masks are made of.
pub const MAP_WIDTH: usize = WIDTH / 8;

#[derive(Module, Debug)]
pub struct Mlp {
    layers: [Linear; 3],
}

impl Mlp {
    pub fn new(to: usize, device: &Device) -> Self {
        Self {
            layers: [WIDTH, WIDTH, to].map(|to| linear(WIDTH, to, true, device)),
        }
    }

    /// Of `[n, 256]`: `[n, to]`.
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        let [a, b, c] = &self.layers;
        c.forward(relu(b.forward(relu(a.forward(x)))))
    }
}

/// To four times the embedding's size. Named `0`, `1` and `3` in the checkpoint.
#[derive(Module, Debug)]
pub struct Upscaling {
    twice: ConvTranspose2d,
    norm: LayerNorm,
    again: ConvTranspose2d,
}

impl Upscaling {
    pub fn new(device: &Device) -> Self {
        Self {
            twice: upscaling_conv([WIDTH, WIDTH / 4], 2, device),
            norm: fine_norm(WIDTH / 4, device),
            again: upscaling_conv([WIDTH / 4, MAP_WIDTH], 2, device),
        }
    }

    /// Of `[b, h, w, 256]`: `[b, 4 h, 4 w, 32]`. `fine` are finer maps of the image to be added
    /// where sizes are those, `[1, 2 h, 2 w, 64]` and `[1, 4 h, 4 w, 32]`, or `b` of them.
    pub fn forward(&self, x: Tensor<4>, fine: Option<[Tensor<4>; 2]>) -> Tensor<4> {
        let [half, whole] = fine.map_or([None, None], |fine| fine.map(Some));
        let add = |x: Tensor<4>, fine: Option<Tensor<4>>| match fine {
            Some(fine) => x + fine,
            None => x,
        };
        let x = gelu(self.norm.forward(add(doubled(&self.twice, x), half)));
        gelu(add(doubled(&self.again, x), whole))
    }
}

/// `conv`, whose kernel and steps are 2 by 2, of `x` `[b, h, w, c]`: one matrix product, as its
/// kernels do not overlap.
fn doubled(conv: &ConvTranspose2d, x: Tensor<4>) -> Tensor<4> {
    let weight = conv.weight.val();
    let [c, to, _, _] = weight.dims();
    let [b, h, w, _] = x.dims();
    let weight = weight.permute([0, 2, 3, 1]).reshape([c, 4 * to]);
    let spread = x
        .reshape([b * h * w, c])
        .matmul(weight)
        .reshape([b, h, w, 2, 2, to]);
    let x = spread
        .permute([0, 1, 3, 2, 4, 5])
        .reshape([b, 2 * h, 2 * w, to]);
    match &conv.bias {
        Some(bias) => x + bias.val().reshape([1, 1, 1, to]),
        None => x,
    }
}
