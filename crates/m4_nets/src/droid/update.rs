//! The update operator: from what images and geometry say of an edge to how far its pixels should
//! move.

use super::WIDTH;
use crate::correlation::taps;
use crate::ops::{conv, convolve, fine_norm, gelu, over_channels, sigmoid, tanh, with_weights};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::activation::{relu, softplus};
use burn_core::tensor::{DType, Device, Int, Tensor};
use burn_nn::LayerNorm;
use burn_nn::conv::Conv2d;

/// Levels of the correlation and how far each looks, in its pixels.
pub const LEVELS: usize = 4;
pub const RADIUS: usize = 3;

/// Two convolutions, the first at most as wide as the network; an activation follows each. Numbered
/// 0 and 2 in the checkpoint.
#[derive(Module, Debug)]
pub struct Pair {
    hidden: Conv2d,
    out: Conv2d,
}

impl Pair {
    fn new([from, to]: [usize; 2], [first, second]: [usize; 2], device: &Device) -> Self {
        Self {
            hidden: conv([from, WIDTH], first, 1, true, device),
            out: conv([WIDTH, to], second, 1, true, device),
        }
    }

    /// Without the activation of the second.
    fn forward(&self, x: Tensor<4>, activation: impl Fn(Tensor<4>) -> Tensor<4>) -> Tensor<4> {
        convolve([activation(convolve([x], &self.hidden))], &self.out)
    }
}

#[derive(Module, Debug)]
pub struct Update {
    corr_encoder: Pair,
    flow_encoder: Pair,
    weight: Pair,
    delta: Pair,
    pub gru: Gru,
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
    pub fn keep_two_rows(&mut self) {
        for layer in [&mut self.weight.out, &mut self.delta.out] {
            let weight = layer.weight.val().narrow(0, 0, 2);
            let bias = layer.bias.as_ref().map(|bias| bias.val().narrow(0, 0, 2));
            *layer = with_weights(layer.clone(), weight, bias);
        }
    }

    /// The hidden states that follow `hidden` `[n, 128, h, w]`, with what the context adds by
    /// `gru`, scores `[n, 196, h, w]` and motion `[n, 4, h, w]` (`None` for zeros).
    pub fn advance(
        &self,
        gru: &ArrangedGru,
        hidden: Tensor<4>,
        context: Tensor<4>,
        corr: Tensor<4>,
        motion: Option<Tensor<4>>,
    ) -> Tensor<4> {
        let [n, _, h, w] = hidden.dims();
        let motion = motion
            .unwrap_or_else(|| Tensor::zeros([n, 4, h, w], (&hidden.device(), hidden.dtype())));
        let corr = relu(self.corr_encoder.forward(corr, relu));
        let flow = relu(self.flow_encoder.forward(motion, relu));
        gru.forward(hidden, context, corr, flow)
    }

    /// How far the positions of edges with `hidden` should move, `[n, 2, h, w]`: pixels right and
    /// down.
    pub fn delta(&self, hidden: Tensor<4>) -> Tensor<4> {
        self.delta.forward(hidden, relu)
    }

    /// How much the two components count, `[n, 2, h, w]` in 0..1.
    pub fn weight(&self, hidden: Tensor<4>) -> Tensor<4> {
        sigmoid(self.weight.forward(hidden, relu))
    }
}

/// Side of the block of pixels that a pixel of the grid stands for.
const BLOCK: usize = 8;

/// Damping and upsampling weights of a source frame, from the mean over its edges.
#[derive(Module, Debug)]
pub struct Aggregation {
    conv1: Conv2d,
    conv2: Conv2d,
    eta: Conv2d,
    upmask: Conv2d,
}

impl Aggregation {
    pub fn new(device: &Device) -> Self {
        Self {
            conv1: conv([WIDTH, WIDTH], 3, 1, true, device),
            conv2: conv([WIDTH, WIDTH], 3, 1, true, device),
            eta: conv([WIDTH, 1], 3, 1, true, device),
            upmask: conv([WIDTH, 9 * BLOCK * BLOCK], 1, 1, true, device),
        }
    }

    /// What is averaged over the edges: of hidden states `[n, 128, h, w]` their sum
    /// `[1, 128, h, w]`.
    pub fn sum_of(&self, hidden: Tensor<4>) -> Tensor<4> {
        relu(convolve([hidden], &self.conv1)).sum_dim(0)
    }

    /// Of the mean, what the two outputs share.
    pub fn of_mean(&self, mean: Tensor<4>) -> Tensor<4> {
        relu(convolve([mean], &self.conv2))
    }

    /// The damping of the disparities, `[1, 1, h, w]`.
    pub fn eta(&self, shared: Tensor<4>) -> Tensor<4> {
        softplus(convolve([shared], &self.eta), 1.0).mul_scalar(0.01)
    }
}
/// The head (MegaSaM, section 3.2.1). What the checkpoint has beside it (`conv4`, `norm_4`, `eta`)
/// only training used.
#[derive(Module, Debug)]
pub struct MotionHead {
    conv0: Conv2d,
    conv1: Conv2d,
    conv3: Conv2d,
    conv5: Conv2d,
    norm_0: LayerNorm,
    norm_1: LayerNorm,
    norm_3: LayerNorm,
    norm_5: LayerNorm,
    logits_2: Pair,
}

impl MotionHead {
    pub fn new(device: &Device) -> Self {
        let wide = |from: usize| conv([from, WIDTH], 3, 1, true, device);
        let norm = || fine_norm(WIDTH, device);
        Self {
            conv0: wide(2 * WIDTH + 2),
            conv1: wide(WIDTH),
            conv3: wide(WIDTH),
            conv5: wide(WIDTH),
            norm_0: norm(),
            norm_1: norm(),
            norm_3: norm(),
            norm_5: norm(),
            logits_2: Pair::new([WIDTH, 1], [3, 3], device),
        }
    }

    /// What edges say on their own: of `hidden` `[n, 128, h, w]` and `weight` `[n, 2, h, w]`,
    /// `[n, 128, h, w]`.
    pub fn edges(&self, hidden: Tensor<4>, weight: Tensor<4>) -> Tensor<4> {
        let x = activated(&self.norm_0, self.first(hidden, weight));
        let x = activated(&self.norm_1, convolve([x.clone()], &self.conv1)) + x;
        activated(&self.norm_3, convolve([x.clone()], &self.conv3)) + x
    }

    /// `conv0` of hidden states, their means over the pixels and weights. The means are the same
    /// everywhere, so what they add depends on nothing but which border is near: a convolution of 3
    /// x 3 pixels.
    fn first(&self, hidden: Tensor<4>, weight: Tensor<4>) -> Tensor<4> {
        let [n, c, h, w] = hidden.dims();
        let all = self.conv0.weight.val();
        let part = |from, len| all.clone().narrow(1, from, len);
        let bias = self.conv0.bias.as_ref().map(Param::val);
        let pixels = with_weights(
            self.conv0.clone(),
            Tensor::cat(vec![part(0, c), part(2 * c, 2)], 1),
            bias,
        );
        let means = with_weights(self.conv0.clone(), part(c, c), None);
        let mean = hidden.clone().mean_dims(&[2, 3]).expand([n, c, 3, 3]);
        let nine = means.forward(mean);
        let device = nine.device();
        let spread = |nine: Tensor<4>, dim: usize, extent: usize| {
            let index = (0..extent).map(|i| {
                if i == 0 {
                    0
                } else {
                    1 + i32::from(i + 1 == extent)
                }
            });
            let index = Tensor::<1, Int>::from_data(index.collect::<Vec<_>>().as_slice(), &device);
            nine.select(dim, index)
        };
        convolve([hidden, weight], &pixels) + spread(spread(nine, 2, h), 3, w)
    }

    /// What the edges say together: of the mean over them, `[1, 128, h, w]`.
    pub fn together(&self, mean: Tensor<4>) -> Tensor<4> {
        activated(&self.norm_5, convolve([mean], &self.conv5))
    }

    /// How likely pixels are static, `[n, 1, h, w]` in 0..1, of both.
    pub fn still(&self, edges: Tensor<4>, together: Tensor<4>) -> Tensor<4> {
        sigmoid(self.logits_2.forward(edges + together, gelu))
    }
}

fn activated(norm: &LayerNorm, x: Tensor<4>) -> Tensor<4> {
    gelu(over_channels(norm, x))
}

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
            context: with_weights(
                self.convz.clone(),
                weights(&all, [WIDTH..2 * WIDTH, 0..0]),
                Some(biases(all)),
            ),
            update_reset: with_weights(self.convz.clone(), weights(&all[..2], edge.clone()), None),
            candidate: with_weights(self.convz.clone(), weights(&all[2..], edge), None),
            global: with_weights(
                self.w.clone(),
                weights(&global, [0..WIDTH, 0..0]),
                Some(biases(global)),
            ),
            w: self.w.clone(),
        }
    }
}

/// [`Gru`] with what depends on the source alone taken out, and the gates that read the same
/// numbers as one convolution.
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
    pub fn dtype(&self) -> DType {
        self.w.weight.val().dtype()
    }

    /// What `context` `[1 or n, 128, h, w]` adds to z, r and q: `[1 or n, 384, h, w]`.
    pub fn context(&self, context: Tensor<4>) -> Tensor<4> {
        convolve([context], &self.context)
    }

    /// The hidden states that follow `hidden` `[n, 128, h, w]`, with what
    /// [`context`](Self::context) gave, the encoded correlation `[n, 128, h, w]` and flow
    /// `[n, 64, h, w]`.
    pub fn forward(
        &self,
        hidden: Tensor<4>,
        context: Tensor<4>,
        corr: Tensor<4>,
        flow: Tensor<4>,
    ) -> Tensor<4> {
        let glo = sigmoid(self.w.forward(hidden.clone())) * hidden.clone();
        // [n, 384, 1, 1]
        let glo = self.global.forward(glo.mean_dims(&[2, 3]));
        let added = |from: usize, n: usize| {
            context.clone().narrow(1, from * WIDTH, n * WIDTH)
                + glo.clone().narrow(1, from * WIDTH, n * WIDTH)
        };
        let zr = convolve(
            [hidden.clone(), corr.clone(), flow.clone()],
            &self.update_reset,
        );
        let zr = sigmoid(zr + added(0, 2));
        let z = zr.clone().narrow(1, 0, WIDTH);
        let r = zr.narrow(1, WIDTH, WIDTH);
        let q = convolve([r * hidden.clone(), corr, flow], &self.candidate);
        let q = tanh(q + added(2, 1));
        hidden.clone() + z * (q - hidden)
    }
}
