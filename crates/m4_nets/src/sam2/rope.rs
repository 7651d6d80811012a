//! Positions as rotations: channels in pairs, each turned by its own angle a column or a row (Su et al., "RoFormer", 2021; in two
//! directions as Heo et al., "Rotary Position Embedding for Vision Transformer", ECCV 2024).
//!
//! Upstream turns neighbouring channels as one complex number. Here the first channels of all pairs come before the second ones:
//! scores do not depend on the order of channels, so that the layers which make queries and keys are [reordered](halves_apart) once,
//! and a rotation reads whole rows.

use crate::ops::tensor;
use crate::sam::WIDTH;
use burn_core::module::Param;
use burn_core::tensor::{DType, Device, Int, Tensor, TensorData};
use burn_nn::Linear;

/// Pairs of channels.
const PAIRS: usize = WIDTH / 2;
/// The wavelengths' ratio, all together.
const THETA: f32 = 10_000.0;

/// Cosines and sines of a square map, `[1, 1, n, 128]` each.
#[derive(Debug, Clone)]
pub struct Rotations {
    cos: Tensor<4>,
    sin: Tensor<4>,
}

impl Rotations {
    /// Of a map of `side` rows and columns.
    pub fn new(side: usize, device: &Device, dtype: DType) -> Self {
        let frequency = |i: usize| 1.0 / THETA.powf((4 * i) as f32 / WIDTH as f32);
        let angle = |i: usize| {
            let (at, pair) = (i / PAIRS, i % PAIRS);
            let half = PAIRS / 2;
            let steps = if pair < half { at % side } else { at / side };
            steps as f32 * frequency(pair % half)
        };
        let angles: Vec<f32> = (0..side * side * PAIRS).map(angle).collect();
        let table = |f: fn(f32) -> f32| {
            let values = angles.iter().map(|&a| f(a)).collect();
            tensor(values, [1, 1, side * side, PAIRS], device).cast(dtype)
        };
        Self { cos: table(f32::cos), sin: table(f32::sin) }
    }

    /// Places of a map.
    fn places(&self) -> usize {
        self.cos.dims()[2]
    }

    /// `x` `[b, r n, 256]`, some maps one after the other, turned.
    pub fn turn(&self, x: Tensor<3>) -> Tensor<3> {
        let [b, m, c] = x.dims();
        let n = self.places();
        let x = x.reshape([b, m / n, n, c]);
        let (first, second) = (x.clone().narrow(3, 0, PAIRS), x.narrow(3, PAIRS, PAIRS));
        let along = first.clone() * self.cos.clone() - second.clone() * self.sin.clone();
        let across = first * self.sin.clone() + second * self.cos.clone();
        Tensor::cat(vec![along, across], 3).reshape([b, m, c])
    }
}

/// `layer`, whose outputs are pairs of channels, with all first ones before all second ones.
pub fn halves_apart(layer: Linear) -> Linear {
    let order: Vec<i32> = (0..2).flat_map(|k| (0..PAIRS as i32).map(move |i| 2 * i + k)).collect();
    let order = Tensor::<1, Int>::from_data(TensorData::new(order, [WIDTH]), &layer.weight.val().device());
    Linear {
        weight: Param::from_tensor(layer.weight.val().select(1, order.clone())),
        bias: layer.bias.map(|bias| Param::from_tensor(bias.val().select(0, order))),
    }
}
