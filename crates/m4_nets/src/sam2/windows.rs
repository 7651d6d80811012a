//! Maps cut into square windows, and maps with half the rows and columns.

use burn_core::tensor::Tensor;
use burn_core::tensor::ops::PadMode;

/// `x` `[n, h, w, c]` cut into windows of `side` by `side`, zeros beyond the map: `[n rows columns, side, side, c]`.
pub fn cut(x: Tensor<4>, side: usize) -> Tensor<4> {
    let [n, h, w, c] = x.dims();
    let [rows, columns] = [h.div_ceil(side), w.div_ceil(side)];
    let x = if rows * side == h && columns * side == w {
        x
    } else {
        let beyond = [(0, 0), (0, rows * side - h), (0, columns * side - w), (0, 0)];
        x.pad(beyond, PadMode::Constant(0.0))
    };
    x.reshape([n, rows, side, columns, side, c]).swap_dims(2, 3).reshape([n * rows * columns, side, side, c])
}

/// What [`cut`] made of `n` maps, put together to maps of `h` by `w`; what lies beyond is left out.
pub fn joined(windows: Tensor<4>, n: usize, [h, w]: [usize; 2]) -> Tensor<4> {
    let [_, side, _, c] = windows.dims();
    let [rows, columns] = [h.div_ceil(side), w.div_ceil(side)];
    let x =
        windows.reshape([n, rows, columns, side, side, c]).swap_dims(2, 3).reshape([n, rows * side, columns * side, c]);
    if rows * side == h && columns * side == w { x } else { x.narrow(1, 0, h).narrow(2, 0, w) }
}

/// The largest of each 2 by 2 pixels of `x` `[n, h, w, c]`: `[n, h / 2, w / 2, c]`; a last odd row or column is left out.
pub fn halved(x: Tensor<4>) -> Tensor<4> {
    let [n, h, w, c] = x.dims();
    let [rows, columns] = [h / 2, w / 2];
    let x = x.narrow(1, 0, 2 * rows).narrow(2, 0, 2 * columns).reshape([n * rows, 2, columns, 2 * c]);
    let x = x.clone().narrow(1, 0, 1).max_pair(x.narrow(1, 1, 1));
    let x = x.reshape([n, rows, columns, 2 * c]);
    x.clone().narrow(3, 0, c).max_pair(x.narrow(3, c, c))
}
