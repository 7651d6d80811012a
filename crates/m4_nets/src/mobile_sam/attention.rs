//! TinyViT's attention: within square windows, with a learned number for each distance.

use super::layers::{heads, zeros};
use crate::ops::{linear, norm};
use burn_core as burn;
use burn_core::module::{Module, Param};
use burn_core::tensor::ops::PadMode;
use burn_core::tensor::{Device, Int, Tensor, TensorData};
use burn_nn::{LayerNorm, Linear};

/// Attention within windows of `window` by `window` pixels.
#[derive(Module, Debug)]
pub struct Windowed {
    norm: LayerNorm,
    qkv: Linear,
    proj: Linear,
    /// `[heads, window^2]`: what is added to a score, at `|dy| window + |dx|`.
    attention_biases: Param<Tensor<2>>,
    window: usize,
}

impl Windowed {
    pub fn new(width: usize, heads: usize, window: usize, device: &Device) -> Self {
        Self {
            norm: norm(width, device),
            qkv: linear(width, 3 * width, true, device),
            proj: linear(width, width, true, device),
            attention_biases: zeros([heads, window * window], device),
            window,
        }
    }

    /// Of `[1, h, w, c]`: the same shape, to be added to it. Beyond the map lie zeros, which take part as pixels.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let [_, h, w, c] = x.dims();
        let side = self.window;
        let [rows, columns] = [h.div_ceil(side), w.div_ceil(side)];
        let beyond = [(0, 0), (0, rows * side - h), (0, columns * side - w), (0, 0)];
        let windows = x
            .pad(beyond, PadMode::Constant(0.0))
            .reshape([rows, side, columns, side, c])
            .swap_dims(1, 2)
            .reshape([rows * columns, side * side, c]);
        self.within(windows)
            .reshape([rows, columns, side, side, c])
            .swap_dims(1, 2)
            .reshape([1, rows * side, columns * side, c])
            .narrow(1, 0, h)
            .narrow(2, 0, w)
    }

    /// Of windows `[n, l, c]`: the same shape.
    fn within(&self, x: Tensor<3>) -> Tensor<3> {
        let [n, l, c] = x.dims();
        let [count, _] = self.attention_biases.dims();
        let width = c / count;
        let qkv = self.qkv.forward(self.norm.forward(x)).reshape([n, l, count, 3 * width]).swap_dims(1, 2);
        let [q, k, v] = [0, 1, 2].map(|i| qkv.clone().narrow(3, i * width, width));
        let found = heads(q, k, v, Some(self.biases()));
        self.proj.forward(found.swap_dims(1, 2).reshape([n, l, c]))
    }

    /// What is added to the scores, `[1, heads, window^2, window^2]`.
    fn biases(&self) -> Tensor<4> {
        let biases = self.attention_biases.val();
        let [count, l] = biases.dims();
        let side = self.window;
        let distance = |a: usize, b: usize| (a / side).abs_diff(b / side) * side + (a % side).abs_diff(b % side);
        let at: Vec<i32> = (0..l * l).map(|i| distance(i / l, i % l) as i32).collect();
        let at = Tensor::<1, Int>::from_data(TensorData::new(at, [l * l]), &biases.device());
        biases.select(1, at).reshape([1, count, l, l])
    }
}
