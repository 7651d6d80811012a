//! Colour correction of one frame, after compositing.

use crate::blend::reference::CHANNELS;
use m4_core::Real;

/// `c' = M c + b` for the colours of every pixel, `[M | b]` row by row (docs/spec/optimiser.md 8.4).
pub fn expose<T: Real>(pixels: &[[T; CHANNELS]], exposure: &[[T; 4]; 3]) -> Vec<[T; 3]> {
    pixels.iter().map(|p| exposure.map(|row| row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3])).collect()
}

/// Gradients with respect to the colours of every pixel and the exposure, given `g` with respect to
/// [`expose`].
pub fn expose_vjp<T: Real>(
    pixels: &[[T; CHANNELS]],
    exposure: &[[T; 4]; 3],
    g: &[[T; 3]],
) -> (Vec<[T; 3]>, [[T; 4]; 3]) {
    let mut d_exposure = [[T::zero(); 4]; 3];
    let d_pixels = pixels.iter().zip(g).map(|(p, g)| {
        for (row, &g) in d_exposure.iter_mut().zip(g) {
            for k in 0..3 {
                row[k] += g * p[k];
            }
            row[3] += g;
        }
        std::array::from_fn(|k| exposure[0][k] * g[0] + exposure[1][k] * g[1] + exposure[2][k] * g[2])
    });
    (d_pixels.collect(), d_exposure)
}
