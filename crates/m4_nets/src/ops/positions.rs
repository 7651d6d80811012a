//! Positions as sines and cosines.

use super::tensor;
use burn_core::tensor::{Device, Tensor};
use std::f32::consts::TAU;

/// The position of each pixel of a map of `map` rows and columns within tiles of `tile` rows and columns,
/// `[1, rows, columns, channels]`: sines and cosines of row, then column, at wavelengths from 1 to 10,000, a quarter of the
/// channels each (DETR).
pub fn sine_positions(map: [usize; 2], tile: [usize; 2], channels: usize, device: &Device) -> Tensor<4> {
    let half = channels / 2;
    let [height, width] = map;
    let [h, w] = tile;
    let wave = |at: usize, side: usize, channel: usize| {
        let angle = (at % side + 1) as f32 / (side as f32 + 1e-6) * TAU;
        let angle = angle / 10_000f32.powf((channel / 2 * 2) as f32 / half as f32);
        if channel.is_multiple_of(2) { angle.sin() } else { angle.cos() }
    };
    let table = |n: usize, side: usize| -> Vec<f32> { (0..n * half).map(|i| wave(i / half, side, i % half)).collect() };
    let rows: Tensor<4> = tensor(table(height, h), [1, height, 1, half], device);
    let columns: Tensor<4> = tensor(table(width, w), [1, 1, width, half], device);
    let all = [1, height, width, half];
    Tensor::cat(vec![rows.expand(all), columns.expand(all)], 3)
}
