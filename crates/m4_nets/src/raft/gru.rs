//! The recurrent unit, along rows and then along columns.
//!
//! Its input is the context, which is the same in every iteration, and the motion, which is not: what the convolutions make of
//! the context is computed once, a third of the work. The gates `z` and `r` are one convolution.

use crate::ops::{convolve, with_weights, zeros};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::activation::{sigmoid, tanh};
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::{Conv2d, Conv2dConfig};
use burn_nn::{Initializer, PaddingConfig2d};

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
