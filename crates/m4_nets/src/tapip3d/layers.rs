//! Blocks of attention, as CoTracker3 has them: pre-normalised without weights, feed-forward layers
//! with the activation by `tanh`.

use crate::ops::{gelu_by_tanh, in_parts, linear, norm};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::softmax;
use burn_core::tensor::module::layer_norm;
use burn_core::tensor::{Device, Tensor};
use burn_nn::{LayerNorm, Linear};

/// `x` less its mean, by its standard deviation, over the last axis.
fn plain_norm(x: Tensor<3>) -> Tensor<3> {
    let [_, _, c] = x.dims();
    let ones = Tensor::ones([c], (&x.device(), x.dtype()));
    layer_norm(x, ones, None, 1e-6)
}

/// Keys and values of every head, `[b, heads, n, c]` each.
#[derive(Debug, Clone)]
pub struct KeysValues(pub Tensor<4>, pub Tensor<4>);

/// Attention of tokens to others.
#[derive(Module, Debug)]
pub struct Attention {
    to_q: Linear,
    to_kv: Linear,
    to_out: Linear,
    heads: usize,
}

impl Attention {
    /// Of tokens of `width` channels, in `heads` heads that have `inner` together; `biased` if
    /// queries, keys and values are.
    pub fn new(width: usize, inner: usize, heads: usize, biased: bool, device: &Device) -> Self {
        Self {
            to_q: linear(width, inner, biased, device),
            to_kv: linear(width, 2 * inner, biased, device),
            to_out: linear(inner, width, true, device),
            heads,
        }
    }

    fn split(&self, x: Tensor<3>) -> Tensor<4> {
        let [b, n, c] = x.dims();
        x.reshape([b, n, self.heads, c / self.heads])
            .swap_dims(1, 2)
    }

    /// Queries of every head of `x` `[b, n, width]`, scaled, `[b, heads, n, c]`.
    pub fn queries(&self, x: Tensor<3>) -> Tensor<4> {
        let q = self.split(flat(x, |x| self.to_q.forward(x)));
        let [_, _, _, c] = q.dims();
        q.mul_scalar(1.0 / (c as f32).sqrt())
    }

    /// Keys and values of `x` `[b, n, width]`.
    pub fn keys_values(&self, x: Tensor<3>) -> KeysValues {
        let both = flat(x, |x| self.to_kv.forward(x));
        let [_, _, c] = both.dims();
        let [k, v] = [0, c / 2].map(|at| self.split(both.clone().narrow(2, at, c / 2)));
        KeysValues(k, v)
    }

    /// The attention of queries to keys and values, `[b, n, width]`.
    pub fn attend(&self, q: Tensor<4>, KeysValues(k, v): KeysValues) -> Tensor<3> {
        let scores = softmax(q.matmul(k.swap_dims(2, 3)), 3);
        let attention = scores.matmul(v).swap_dims(1, 2);
        let [b, n, h, c] = attention.dims();
        flat(attention.reshape([b, n, h * c]), |x| self.to_out.forward(x))
    }

    /// [`attend`](Self::attend) for one query token `[1, width]`, as matrices that tokens are
    /// multiplied with.
    pub fn pooling(&self, token: Tensor<2>) -> Pooling {
        let [_, width] = token.dims();
        let q = self.queries(token.unsqueeze_dim(0)).squeeze_dim::<3>(0);
        let [heads, _, c] = q.dims();
        let weights = self
            .to_kv
            .weight
            .val()
            .reshape([width, 2, heads, c])
            .permute([1, 2, 0, 3]);
        let [keys, values] = [0, 1].map(|i| weights.clone().narrow(0, i, 1).squeeze_dim::<3>(0));
        let out = self.to_out.weight.val().reshape([heads, c, width]);
        Pooling {
            scores: keys
                .matmul(q.swap_dims(1, 2))
                .squeeze_dim::<2>(2)
                .transpose(),
            values: values.matmul(out).reshape([heads * width, width]),
            bias: self.to_out.bias.as_ref().map(|bias| bias.val()),
        }
    }
}

/// The attention of one token that is always the same: what is multiplied with it is known before.
#[derive(Debug, Clone)]
pub struct Pooling {
    /// `[width, heads]`.
    scores: Tensor<2>,
    /// `[heads * width, width]`.
    values: Tensor<2>,
    bias: Option<Tensor<1>>,
}

impl Pooling {
    /// Of tokens `[b, n, width]`: `[b, width]`.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<2> {
        let [b, _, width] = x.dims();
        let [_, heads] = self.scores.dims();
        let scores = flat(x.clone(), |x| x.matmul(self.scores.clone()));
        let output = softmax(scores.swap_dims(1, 2), 2).matmul(x);
        let output = output
            .reshape([b, heads * width])
            .matmul(self.values.clone());
        match &self.bias {
            Some(bias) => output + bias.clone().unsqueeze(),
            None => output,
        }
    }
}

/// `layer` of the rows of `x` `[b, n, c]`, all in one matrix.
fn flat(x: Tensor<3>, layer: impl FnOnce(Tensor<2>) -> Tensor<2>) -> Tensor<3> {
    let [b, n, c] = x.dims();
    let y = layer(x.reshape([b * n, c]));
    let [_, to] = y.dims();
    y.reshape([b, n, to])
}

#[derive(Module, Debug)]
pub struct Mlp {
    fc1: Linear,
    fc2: Linear,
}

/// Tokens that the feed-forward layer takes at a time.
const MLP_TOKENS: usize = 512;

impl Mlp {
    fn new(width: usize, hidden: usize, device: &Device) -> Self {
        Self {
            fc1: linear(width, hidden, true, device),
            fc2: linear(hidden, width, true, device),
        }
    }

    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        flat(x, |x| {
            in_parts(x, 0, MLP_TOKENS, |x| {
                self.fc2.forward(gelu_by_tanh(self.fc1.forward(x)))
            })
        })
    }
}

/// Tokens among themselves.
#[derive(Module, Debug)]
pub struct SelfBlock {
    attn: Attention,
    mlp: Mlp,
}

impl SelfBlock {
    pub fn new(width: usize, hidden: usize, heads: usize, device: &Device) -> Self {
        Self {
            attn: Attention::new(width, width, heads, true, device),
            mlp: Mlp::new(width, hidden, device),
        }
    }

    /// Of tokens `[b, n, width]`: the same shape.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let y = plain_norm(x.clone());
        let x = x + self
            .attn
            .attend(self.attn.queries(y.clone()), self.attn.keys_values(y));
        x.clone() + self.mlp.forward(plain_norm(x))
    }
}

/// Tokens in the light of others.
#[derive(Module, Debug)]
pub struct CrossBlock {
    norm_context: LayerNorm,
    cross_attn: Attention,
    mlp: Mlp,
}

impl CrossBlock {
    pub fn new(width: usize, inner: usize, hidden: usize, heads: usize, device: &Device) -> Self {
        Self {
            norm_context: norm(width, device),
            cross_attn: Attention::new(width, inner, heads, true, device),
            mlp: Mlp::new(width, hidden, device),
        }
    }

    /// The queries of tokens `[b, n, width]`.
    pub fn queries(&self, x: Tensor<3>) -> Tensor<4> {
        self.cross_attn.queries(plain_norm(x))
    }

    /// Keys and values of the others `[b, m, width]`.
    pub fn context(&self, x: Tensor<3>) -> KeysValues {
        self.cross_attn.keys_values(self.norm_context.forward(x))
    }

    /// The tokens `x`, whose queries are `q`, in the light of `others`: the shape of `x`.
    pub fn revised(&self, x: Tensor<3>, q: Tensor<4>, others: KeysValues) -> Tensor<3> {
        let x = x + self.cross_attn.attend(q, others);
        x.clone() + self.mlp.forward(plain_norm(x))
    }

    /// Tokens `x` `[b, n, width]` in the light of `others` `[b, m, width]`: the shape of `x`.
    pub fn forward(&self, x: Tensor<3>, others: Tensor<3>) -> Tensor<3> {
        let (q, others) = (self.queries(x.clone()), self.context(others));
        self.revised(x, q, others)
    }
}
