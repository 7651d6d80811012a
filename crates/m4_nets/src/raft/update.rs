//! What one iteration adds to the flow (section 3.3 of the paper).

use crate::ops::{conv, conv_by, convolve, with_weights};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::activation::{relu, sigmoid, tanh};
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::Conv2d;

/// Rows and columns of the image in a pixel of the map.
pub const FACTOR: usize = 8;
/// The checkpoint's weights of upsampling are this much too large: in training it balanced their
/// gradients.
const MASK_SCALE: f32 = 0.25;

/// Of the correlations around where the flow points, and of that flow: the motion.
#[derive(Module, Debug)]
pub struct MotionEncoder {
    convc1: Conv2d,
    convc2: Conv2d,
    convf1: Conv2d,
    convf2: Conv2d,
    conv: Conv2d,
}

impl MotionEncoder {
    /// Of `correlation` `[n, 324, h, w]` and `flow` `[n, 2, h, w]`: `[n, 128, h, w]`, whose last
    /// two channels are the flow.
    pub fn forward(&self, correlation: Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
        let layer = |x, conv| relu(convolve([x], conv));
        let correlation = layer(layer(correlation, &self.convc1), &self.convc2);
        let motion = layer(layer(flow.clone(), &self.convf1), &self.convf2);
        let both = relu(convolve([correlation, motion], &self.conv));
        Tensor::cat(vec![both, flow], 1)
    }
}

/// Of the hidden state: what the flow changes by.
#[derive(Module, Debug)]
pub struct FlowHead {
    conv1: Conv2d,
    conv2: Conv2d,
}

impl FlowHead {
    /// Of `[n, 128, h, w]`: `[n, 2, h, w]`, in pixels of the map.
    pub fn forward(&self, hidden: Tensor<4>) -> Tensor<4> {
        convolve([relu(convolve([hidden], &self.conv1))], &self.conv2)
    }
}

/// Of the hidden state: weights of upsampling. Named `mask.0` and `mask.2` in the checkpoint.
#[derive(Module, Debug)]
pub struct MaskHead {
    hidden: Conv2d,
    weights: Conv2d,
}

impl MaskHead {
    /// Of `[n, 128, h, w]`: `[n, 9 8 8, h, w]`, before their softmax.
    pub fn forward(&self, hidden: Tensor<4>) -> Tensor<4> {
        let hidden = relu(convolve([hidden], &self.hidden));
        convolve([hidden], &self.weights).mul_scalar(MASK_SCALE)
    }
}

#[derive(Module, Debug)]
pub struct UpdateBlock {
    pub encoder: MotionEncoder,
    pub gru: SepConvGru,
    pub flow_head: FlowHead,
    pub mask: MaskHead,
}

impl UpdateBlock {
    /// For `correlations` a pixel.
    pub fn new(correlations: usize, device: &Device) -> Self {
        let layer = |from, to, kernel| conv([from, to], kernel, 1, true, device);
        Self {
            encoder: MotionEncoder {
                convc1: layer(correlations, 256, 1),
                convc2: layer(256, 192, 3),
                convf1: layer(2, 128, 7),
                convf2: layer(128, 64, 3),
                conv: layer(64 + 192, WIDTH - 2, 3),
            },
            gru: SepConvGru::new(device),
            flow_head: FlowHead {
                conv1: layer(WIDTH, 256, 3),
                conv2: layer(256, 2, 3),
            },
            mask: MaskHead {
                hidden: layer(WIDTH, 256, 3),
                weights: layer(256, 9 * FACTOR * FACTOR, 1),
            },
        }
    }
}

/// Channels of the hidden state, of the context and of the motion.
pub const WIDTH: usize = 128;
/// Pixels that a kernel spans.
const SPAN: usize = 5;

/// What of `kernel`, of `[hidden, context, motion]` to [`WIDTH`] channels along one axis, the input
/// number `i` meets.
fn part(kernel: &Conv2d, i: usize) -> Tensor<4> {
    kernel.weight.val().narrow(1, i * WIDTH, WIDTH)
}

/// What the hidden state and the motion meet, side by side.
fn moving(kernel: &Conv2d) -> Tensor<4> {
    Tensor::cat(vec![part(kernel, 0), part(kernel, 2)], 1)
}

/// The unit's weights; 1 is along rows, 2 along columns.
#[derive(Module, Debug)]
pub struct SepConvGru {
    convz1: Conv2d,
    convr1: Conv2d,
    convq1: Conv2d,
    convz2: Conv2d,
    convr2: Conv2d,
    convq2: Conv2d,
}

/// The unit for the context of some images.
#[derive(Debug)]
pub struct Unit {
    passes: [Pass; 2],
}

/// One axis.
#[derive(Debug)]
struct Pass {
    /// From hidden state and motion to both gates.
    gates: Conv2d,
    /// From the gated hidden state and motion to the candidate.
    candidate: Conv2d,
    /// `[n, 256, h, w]`: the context's part of the gates.
    gates_context: Tensor<4>,
    /// `[n, 128, h, w]`: the context's part of the candidate.
    candidate_context: Tensor<4>,
}

impl SepConvGru {
    pub fn new(device: &Device) -> Self {
        let kernel = |size| conv_by([3 * WIDTH, WIDTH], size, true, device);
        let (along_row, along_column) = (|| kernel([1, SPAN]), || kernel([SPAN, 1]));
        Self {
            convz1: along_row(),
            convr1: along_row(),
            convq1: along_row(),
            convz2: along_column(),
            convr2: along_column(),
            convq2: along_column(),
        }
    }

    /// Kernels as they are, `z`, `r` and `q` of each axis.
    #[cfg(test)]
    pub fn kernels(&self) -> [[&Conv2d; 3]; 2] {
        [
            [&self.convz1, &self.convr1, &self.convq1],
            [&self.convz2, &self.convr2, &self.convq2],
        ]
    }

    /// For the context `[n, 128, h, w]`.
    pub fn with_context(&self, context: &Tensor<4>) -> Unit {
        let pass = |z: &Conv2d, r: &Conv2d, q: &Conv2d| {
            let layer =
                |weight: Tensor<4>, bias: Option<Tensor<1>>| with_weights(z.clone(), weight, bias);
            let of_context = |weight, bias| convolve([context.clone()], &layer(weight, bias));
            let bias = [z, r]
                .into_iter()
                .filter_map(|kernel| kernel.bias.as_ref().map(Param::val));
            Pass {
                gates: layer(Tensor::cat(vec![moving(z), moving(r)], 0), None),
                candidate: layer(moving(q), None),
                gates_context: of_context(
                    Tensor::cat(vec![part(z, 1), part(r, 1)], 0),
                    Some(Tensor::cat(bias.collect(), 0)),
                ),
                candidate_context: of_context(part(q, 1), q.bias.as_ref().map(Param::val)),
            }
        };
        Unit {
            passes: [
                pass(&self.convz1, &self.convr1, &self.convq1),
                pass(&self.convz2, &self.convr2, &self.convq2),
            ],
        }
    }
}

impl Unit {
    /// The next hidden state, of `hidden` and `motion`, each `[n, 128, h, w]`.
    pub fn forward(&self, hidden: Tensor<4>, motion: &Tensor<4>) -> Tensor<4> {
        self.passes.iter().fold(hidden, |h, pass| {
            let gates = convolve([h.clone(), motion.clone()], &pass.gates);
            let gates = sigmoid(gates + pass.gates_context.clone());
            let z = gates.clone().narrow(1, 0, WIDTH);
            let r = gates.narrow(1, WIDTH, WIDTH);
            let q = convolve([r * h.clone(), motion.clone()], &pass.candidate);
            let q = tanh(q + pass.candidate_context.clone());
            h.clone() + z * (q - h)
        })
    }
}
