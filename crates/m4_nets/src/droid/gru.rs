//! The recurrent unit whose hidden state an edge keeps.

use super::WIDTH;
use crate::ops::{conv, convolve};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::activation::sigmoid;
use burn_core::tensor::{DType, Device, Tensor};
use burn_nn::conv::Conv2d;

/// Channels of the encoded motion.
const FLOW: usize = 64;

/// A convolutional gated recurrent unit with a global context, as in the checkpoint.
#[derive(Module, Debug)]
pub struct Gru {
    convz: Conv2d,
    convr: Conv2d,
    convq: Conv2d,
    w: Conv2d,
    convz_glo: Conv2d,
    convr_glo: Conv2d,
    convq_glo: Conv2d,
}

impl Gru {
    pub fn new(device: &Device) -> Self {
        let gate = || conv([3 * WIDTH + FLOW, WIDTH], 3, 1, true, device);
        let global = || conv([WIDTH, WIDTH], 1, 1, true, device);
        Self {
            convz: gate(),
            convr: gate(),
            convq: gate(),
            w: global(),
            convz_glo: global(),
            convr_glo: global(),
            convq_glo: global(),
        }
    }

    /// The same, arranged for edges that share a source.
    pub fn arranged(&self) -> ArrangedGru {
        let weights = |gates: &[&Conv2d], channels: [std::ops::Range<usize>; 2]| {
            let of = |gate: &&Conv2d| {
                let parts = channels.iter().filter(|c| !c.is_empty());
                let parts = parts.map(|c| gate.weight.val().narrow(1, c.start, c.len()));
                Tensor::cat(parts.collect(), 1)
            };
            Tensor::cat(gates.iter().map(of).collect(), 0)
        };
        let all = [&self.convz, &self.convr, &self.convq];
        let global = [&self.convz_glo, &self.convr_glo, &self.convq_glo];
        let biases = |convs: [&Conv2d; 3]| {
            let biases = convs.iter().filter_map(|c| c.bias.as_ref().map(Param::val));
            Tensor::<1>::cat(biases.collect(), 0)
        };
        let edge = [0..WIDTH, 2 * WIDTH..3 * WIDTH + FLOW];
        ArrangedGru {
            context: with_weights(&self.convz, weights(&all, [WIDTH..2 * WIDTH, 0..0]), Some(biases(all))),
            update_reset: with_weights(&self.convz, weights(&all[..2], edge.clone()), None),
            candidate: with_weights(&self.convz, weights(&all[2..], edge), None),
            global: with_weights(&self.w, weights(&global, [0..WIDTH, 0..0]), Some(biases(global))),
            w: self.w.clone(),
        }
    }
}

/// `like` with other weights.
fn with_weights(like: &Conv2d, weight: Tensor<4>, bias: Option<Tensor<1>>) -> Conv2d {
    let mut conv = like.clone();
    conv.weight = Param::from_tensor(weight);
    conv.bias = bias.map(Param::from_tensor);
    conv
}

/// [`Gru`] with what depends on the source alone taken out, and the gates that read the same numbers as one convolution.
#[derive(Debug, Clone)]
pub struct ArrangedGru {
    /// Context to z, r, q.
    context: Conv2d,
    /// Hidden, correlation, flow to z, r.
    update_reset: Conv2d,
    /// Reset hidden, correlation, flow to q.
    candidate: Conv2d,
    /// The global context to z, r, q.
    global: Conv2d,
    w: Conv2d,
}

impl ArrangedGru {
    /// The type of its weights.
    pub fn dtype(&self) -> DType {
        self.w.weight.val().dtype()
    }

    /// What `context` `[1 or n, 128, h, w]` adds to z, r and q: `[1 or n, 384, h, w]`.
    pub fn context(&self, context: Tensor<4>) -> Tensor<4> {
        convolve(&[context], &self.context)
    }

    /// The hidden states that follow `hidden` `[n, 128, h, w]`, with what [`context`](Self::context) gave, the encoded
    /// correlation `[n, 128, h, w]` and flow `[n, 64, h, w]`.
    pub fn forward(&self, hidden: Tensor<4>, context: Tensor<4>, corr: Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
        let glo = sigmoid(self.w.forward(hidden.clone())) * hidden.clone();
        // [n, 384, 1, 1]
        let glo = self.global.forward(glo.mean_dims(&[2, 3]));
        let added = |from: usize, n: usize| {
            context.clone().narrow(1, from * WIDTH, n * WIDTH) + glo.clone().narrow(1, from * WIDTH, n * WIDTH)
        };
        let zr = convolve(&[hidden.clone(), corr.clone(), flow.clone()], &self.update_reset);
        let zr = sigmoid(zr + added(0, 2));
        let z = zr.clone().narrow(1, 0, WIDTH);
        let r = zr.narrow(1, WIDTH, WIDTH);
        let q = convolve(&[r * hidden.clone(), corr, flow], &self.candidate);
        let q = (q + added(2, 1)).tanh();
        hidden.clone() + z * (q - hidden)
    }
}
