//! What one iteration adds to the flow (section 3.3 of the paper).

use super::gru::{SepConvGru, WIDTH};
use crate::ops::{conv, convolve};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{Device, Tensor};
use burn_nn::conv::Conv2d;

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
