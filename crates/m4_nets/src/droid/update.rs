//! The update operator: from what images and geometry say of an edge to how far its pixels should move.

use super::WIDTH;
use super::aggregation::Aggregation;
use super::gru::{ArrangedGru, Gru};
use super::motion::MotionHead;
use crate::correlation::taps;
use crate::ops::{conv, convolve, sigmoid};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::Conv2d;

/// Levels of the correlation and how far each looks, in its pixels.
pub const LEVELS: usize = 4;
pub const RADIUS: usize = 3;

/// Two convolutions, the first at most as wide as the network; an activation follows each. Numbered 0 and 2 in the checkpoint.
#[derive(Module, Debug)]
pub struct Pair {
    hidden: Conv2d,
    out: Conv2d,
}

impl Pair {
    pub fn new(channels: [usize; 2], kernels: [usize; 2], device: &Device) -> Self {
        let [from, to] = channels;
        Self {
            hidden: conv([from, WIDTH], kernels[0], 1, true, device),
            out: conv([WIDTH, to], kernels[1], 1, true, device),
        }
    }

    /// Without the activation of the second.
    pub fn forward(&self, x: Tensor<4>, activation: impl Fn(Tensor<4>) -> Tensor<4>) -> Tensor<4> {
        convolve([activation(convolve([x], &self.hidden))], &self.out)
    }

    /// Keeps the first `n` outputs.
    fn keep(&mut self, n: usize) {
        let mut out = self.out.clone();
        out.weight = out.weight.map(|weight| weight.narrow(0, 0, n));
        out.bias = out.bias.map(|bias| bias.map(|bias| bias.narrow(0, 0, n)));
        self.out = out;
    }
}

/// Fields as in the checkpoint.
#[derive(Module, Debug)]
pub struct Update {
    corr_encoder: Pair,
    flow_encoder: Pair,
    weight: Pair,
    delta: Pair,
    gru: Gru,
    pub agg: Aggregation,
    pub agg_motion: MotionHead,
}

impl Update {
    /// With `rows` outputs of the weights and of the steps, of which two count.
    pub fn new(rows: usize, device: &Device) -> Self {
        Self {
            corr_encoder: Pair::new([taps(LEVELS, RADIUS), WIDTH], [1, 3], device),
            flow_encoder: Pair::new([4, 64], [7, 3], device),
            weight: Pair::new([WIDTH, rows], [3, 3], device),
            delta: Pair::new([WIDTH, rows], [3, 3], device),
            gru: Gru::new(device),
            agg: Aggregation::new(device),
            agg_motion: MotionHead::new(device),
        }
    }

    /// Leaves out the third output of weights and steps that the published checkpoint has.
    pub fn without_third_rows(mut self) -> Self {
        self.weight.keep(2);
        self.delta.keep(2);
        self
    }

    pub fn arranged_gru(&self) -> ArrangedGru {
        self.gru.arranged()
    }

    /// The hidden states that follow `hidden` `[n, 128, h, w]`, with what the context adds by `gru`, scores `[n, 196, h, w]` and
    /// motion `[n, 4, h, w]` (`None` for zeros).
    pub fn advance(
        &self,
        gru: &ArrangedGru,
        hidden: Tensor<4>,
        context: Tensor<4>,
        corr: Tensor<4>,
        motion: Option<Tensor<4>>,
    ) -> Tensor<4> {
        let [n, _, h, w] = hidden.dims();
        let motion = motion.unwrap_or_else(|| Tensor::zeros([n, 4, h, w], (&hidden.device(), hidden.dtype())));
        let corr = relu(self.corr_encoder.forward(corr, relu));
        let flow = relu(self.flow_encoder.forward(motion, relu));
        gru.forward(hidden, context, corr, flow)
    }

    /// How far the positions of edges with `hidden` should move, `[n, 2, h, w]`: pixels right and down.
    pub fn delta(&self, hidden: Tensor<4>) -> Tensor<4> {
        self.delta.forward(hidden, relu)
    }

    /// How much the two components count, `[n, 2, h, w]` in 0..1.
    pub fn weight(&self, hidden: Tensor<4>) -> Tensor<4> {
        sigmoid(self.weight.forward(hidden, relu))
    }
}
