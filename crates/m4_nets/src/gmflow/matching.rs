//! Where each pixel went: a softmax over where it might have gone (sections 3.2 and 3.4).

use crate::ops::{attend, tensor, window_scores};
use burn_core::tensor::activation::softmax;
use burn_core::tensor::ops::{GridSampleOptions, GridSamplePaddingMode, InterpolateMode};
use burn_core::tensor::{Device, Tensor};

/// Column and row of each pixel of a map, `[h w, 2]`.
fn coordinates(h: usize, w: usize, device: &Device) -> Tensor<2> {
    let at = (0..h * w).flat_map(|i| [(i % w) as f32, (i / w) as f32]).collect();
    tensor(at, [h * w, 2], device)
}

/// Of features `[h, w, c]` the flow `[h, w, 2]` from `a` to `b`, in pixels of the map, by comparison of all with all.
pub fn global(a: Tensor<3>, b: Tensor<3>) -> Tensor<3> {
    let [h, w, c] = a.dims();
    let at = coordinates(h, w, &a.device());
    let found = attend(a.reshape([h * w, c]), b.reshape([h * w, c]), at.clone());
    (found - at).reshape([h, w, 2])
}

/// The same by comparison with the pixels of `b` at most `radius` away in row and column.
pub fn local(a: Tensor<3>, b: Tensor<3>, radius: usize) -> Tensor<3> {
    let [h, w, _] = a.dims();
    let device = a.device();
    let side = 2 * radius + 1;
    let outside = |n: usize| -> Vec<f32> {
        let inside = |i: usize| (radius..n + radius).contains(&(i / side + i % side));
        (0..n * side).map(|i| if inside(i) { 0.0 } else { -1e9 }).collect()
    };
    let rows: Tensor<4> = tensor(outside(h), [h, 1, side, 1], &device);
    let columns: Tensor<4> = tensor(outside(w), [1, w, 1, side], &device);
    let scores = window_scores(a, b, radius) + rows + columns;
    let share = softmax(scores.reshape([h * w, side * side]), 1);
    let steps = (0..side * side)
        .flat_map(|i| [i % side, i / side].map(|at| at as f32 - radius as f32))
        .collect();
    share
        .matmul(tensor(steps, [side * side, 2], &device))
        .reshape([h, w, 2])
}

/// The features `[h, w, c]` of the second picture drawn to where `flow` `[h, w, 2]` (pixels) says that they came from;
/// bilinear, 0 outside.
pub fn warp(features: Tensor<3>, flow: Tensor<3>) -> Tensor<3> {
    let [h, w, _] = features.dims();
    let device = features.device();
    let at = coordinates(h, w, &device).reshape([h, w, 2]) + flow;
    let scale: Tensor<3> = tensor(vec![2.0 / (w - 1) as f32, 2.0 / (h - 1) as f32], [1, 1, 2], &device);
    let grid = at * scale - 1.0;
    let options = GridSampleOptions::new(InterpolateMode::Bilinear)
        .with_padding_mode(GridSamplePaddingMode::Zeros)
        .with_align_corners(true);
    features
        .permute([2, 0, 1])
        .unsqueeze::<4>()
        .grid_sample_2d(grid.unsqueeze::<4>(), options)
        .squeeze_dim::<3>(0)
        .permute([1, 2, 0])
}
