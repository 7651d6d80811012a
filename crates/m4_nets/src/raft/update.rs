//! What one iteration adds to the flow (section 3.3 of the paper).

use crate::ops::{conv, convolve, with_weights, zeros};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::activation::{relu, sigmoid, tanh};
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::{Conv2d, Conv2dConfig};
use burn_nn::{Initializer, PaddingConfig2d};

/// Rows and columns of the image in a pixel of the map.
pub const FACTOR: usize = 8;
/// The checkpoint's weights of upsampling are this much too large: in training it balanced their gradients.
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
    /// Of `correlation` `[n, 324, h, w]` and `flow` `[n, 2, h, w]`: `[n, 128, h, w]`, whose last two channels are the flow.
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

/// The parts of an iteration.
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
            flow_head: FlowHead { conv1: layer(WIDTH, 256, 3), conv2: layer(256, 2, 3) },
            mask: MaskHead { hidden: layer(WIDTH, 256, 3), weights: layer(256, 9 * FACTOR * FACTOR, 1) },
        }
    }
}

/// Channels of the hidden state, of the context and of the motion.
pub const WIDTH: usize = 128;
/// Pixels that a kernel spans.
const SPAN: usize = 5;

/// A kernel along one axis, of `[hidden, context, motion]` to [`WIDTH`] channels.
#[derive(Module, Debug)]
pub struct Kernel {
    /// `[128, 384, 1, 5]` or `[128, 384, 5, 1]`.
    weight: Param<Tensor<4>>,
    bias: Param<Tensor<1>>,
}

impl Kernel {
    fn new([rows, columns]: [usize; 2], device: &Device) -> Self {
        Self { weight: zeros([WIDTH, 3 * WIDTH, rows, columns], device), bias: zeros([WIDTH], device) }
    }

    /// What of the kernel the input number `i` meets.
    fn part(&self, i: usize) -> Tensor<4> {
        self.weight.val().narrow(1, i * WIDTH, WIDTH)
    }

    /// What the hidden state and the motion meet, side by side.
    fn moving(&self) -> Tensor<4> {
        Tensor::cat(vec![self.part(0), self.part(2)], 1)
    }
}

/// The unit's weights; 1 is along rows, 2 along columns.
#[derive(Module, Debug)]
pub struct SepConvGru {
    convz1: Kernel,
    convr1: Kernel,
    convq1: Kernel,
    convz2: Kernel,
    convr2: Kernel,
    convq2: Kernel,
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
        let along_row = || Kernel::new([1, SPAN], device);
        let along_column = || Kernel::new([SPAN, 1], device);
        Self {
            convz1: along_row(),
            convr1: along_row(),
            convq1: along_row(),
            convz2: along_column(),
            convr2: along_column(),
            convq2: along_column(),
        }
    }

    /// Kernels and biases as they are, `z`, `r` and `q` of each axis.
    #[cfg(test)]
    pub fn kernels(&self) -> [[(Tensor<4>, Tensor<1>); 3]; 2] {
        [[&self.convz1, &self.convr1, &self.convq1], [&self.convz2, &self.convr2, &self.convq2]]
            .map(|axis| axis.map(|kernel| (kernel.weight.val(), kernel.bias.val())))
    }

    /// For the context `[n, 128, h, w]`.
    pub fn with_context(&self, context: &Tensor<4>) -> Unit {
        let device = context.device();
        let layer = |kernel: Tensor<4>, bias: Option<Tensor<1>>| {
            let [to, from, rows, columns] = kernel.dims();
            let pad = PaddingConfig2d::Explicit(rows / 2, columns / 2, rows / 2, columns / 2);
            let plain = Conv2dConfig::new([from, to], [rows, columns])
                .with_padding(pad)
                .with_bias(false)
                .with_initializer(Initializer::Zeros)
                .init(&device);
            with_weights(plain, kernel, bias)
        };
        let of_context = |kernel, bias| convolve([context.clone()], &layer(kernel, Some(bias)));
        let pass = |z: &Kernel, r: &Kernel, q: &Kernel| {
            let gates = Tensor::cat(vec![z.part(1), r.part(1)], 0);
            let bias = Tensor::cat(vec![z.bias.val(), r.bias.val()], 0);
            Pass {
                gates: layer(Tensor::cat(vec![z.moving(), r.moving()], 0), None),
                candidate: layer(q.moving(), None),
                gates_context: of_context(gates, bias),
                candidate_context: of_context(q.part(1), q.bias.val()),
            }
        };
        Unit {
            passes: [pass(&self.convz1, &self.convr1, &self.convq1), pass(&self.convz2, &self.convr2, &self.convq2)],
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
