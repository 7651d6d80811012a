//! Fits colours by least squares: rounds that distribute the residual of each splat's pixels.
//!
//! With everything else fixed an image is `A c + b`: `A` holds the blending weights, at least 0 and of a sum of at most
//! 1 a pixel. A round is `c += (A^T (target - image)) / (A^T 1 + damping)`, splat by splat and channel by channel: the
//! simultaneous iterative reconstruction technique (Gilbert 1972), whose error never grows (docs/spec/optimiser.md 8, item 7). Both sums
//! are what the renderer's backward pass returns, of the residual and of ones.

use m4_core::{Column, Splats};
use rayon::prelude::*;

/// Rows a task.
const CHUNK_ROWS: usize = 8192;
/// Value of the constant spherical harmonic: a coefficient of the colour counts so much.
const Y00: f32 = m4_kernels::shade::C0 as f32;
/// Least colour that a fit leaves, 0..1: at 0 and below a colour has no gradient any more.
const DARKEST: f32 = 0.004;
/// Added to the sum of a splat's weights, pixels over all frames: splats that are hardly seen hardly change (our choice).
const DAMPING_PX: f32 = 0.1;

/// Frames that a fit of `rounds` rounds draws, in units of what a frame of a step costs; `all` are in the capture.
pub(crate) fn frames_drawn(rounds: usize, all: usize) -> f64 {
    match rounds {
        0 => 0.0,
        rounds => all as f64 * (rounds as f64 + 0.5),
    }
}

/// Sums over the pixels of all frames, `[channel][n]`, as derivatives with respect to the constant coefficient.
#[derive(Debug)]
pub(crate) struct ColourSums {
    residual: [Vec<f32>; 3],
    weight: [Vec<f32>; 3],
}

/// Which of the sums.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sum {
    /// Of weight times image minus target.
    Residual,
    /// Of weights.
    Weight,
}

impl ColourSums {
    /// Of `n` splats.
    pub fn new(n: usize) -> Self {
        let zero = || std::array::from_fn(|_| vec![0.0; n]);
        Self {
            residual: zero(),
            weight: zero(),
        }
    }

    /// Before the next round: weights stay what they are.
    pub fn next_round(&mut self) {
        self.residual.iter_mut().for_each(|plane| plane.fill(0.0));
    }

    /// Adds the gradients of a frame with respect to the constant coefficients, one column per channel; rows that are not
    /// `touched` hold anything.
    pub fn add(&mut self, which: Sum, columns: &[Vec<f32>], touched: &[u8]) {
        let sums = match which {
            Sum::Residual => &mut self.residual,
            Sum::Weight => &mut self.weight,
        };
        for (sum, column) in sums.iter_mut().zip(columns) {
            let rows = column.par_chunks(CHUNK_ROWS).zip(touched.par_chunks(CHUNK_ROWS));
            let chunks = sum.par_chunks_mut(CHUNK_ROWS).zip(rows);
            chunks.for_each(|(sum, (column, touched))| {
                // of a long video most chunks lie in other frames
                if touched.iter().all(|&t| t == 0) {
                    return;
                }
                for ((sum, &g), &touched) in sum.iter_mut().zip(column).zip(touched) {
                    *sum += if touched == 0 { 0.0 } else { g };
                }
            });
        }
    }

    /// Sums that were made elsewhere; without weights those there are stay.
    pub fn replace(&mut self, residual: [Vec<f32>; 3], weight: [Vec<f32>; 3]) {
        self.residual = residual;
        if !weight[0].is_empty() {
            self.weight = weight;
        }
    }

    /// Moves the colours.
    pub fn apply(&self, splats: &mut Splats) {
        let constant = splats.layout().colour_terms() == 1;
        for k in 0..3 {
            let column = splats.column_mut(Column::Colour, k);
            for ((c, &residual), &weight) in column.iter_mut().zip(&self.residual[k]).zip(&self.weight[k]) {
                // never seen, or too dark to have a gradient
                if weight <= 0.0 {
                    continue;
                }
                let missing = residual / (weight + Y00 * DAMPING_PX);
                let moved = *c - missing / Y00;
                let floor = if constant {
                    (DARKEST - 0.5) / Y00
                } else {
                    f32::NEG_INFINITY
                };
                *c = moved.max(floor.min(*c));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{ColourSums, DAMPING_PX, DARKEST, Sum, Y00, frames_drawn};
    use m4_core::{Column, SplatLayout, Splats};

    #[test]
    fn a_fit_costs_its_rounds_and_half_a_round() {
        assert_eq!(frames_drawn(2, 10), 25.0);
        assert_eq!(frames_drawn(0, 10), 0.0);
    }

    #[test]
    fn a_colour_moves_by_the_weighted_mean_of_what_is_missing() {
        let layout = SplatLayout {
            isotropic: true,
            sh_degree: 0,
            time_degree: 0,
        };
        let mut splats = Splats::zeros(layout, 3, 0);
        let mut sums = ColourSums::new(3);
        let nan = f32::NAN;
        // weights 0.5 and 0.25 on two pixels that lack 0.2 and 0.4; the second splat is seen nowhere
        let weights = [0.75 * Y00, nan, 2.0 * Y00];
        let residuals = [-(0.5 * 0.2 + 0.25 * 0.4) * Y00, nan, 4.0 * Y00];
        sums.add(
            Sum::Weight,
            &[weights.to_vec(), weights.to_vec(), weights.to_vec()],
            &[1, 0, 1],
        );
        for _ in 0..2 {
            sums.next_round();
            sums.add(
                Sum::Residual,
                &[residuals.to_vec(), vec![0.0; 3], vec![0.0; 3]],
                &[1, 0, 1],
            );
        }
        sums.apply(&mut splats);
        let red = splats.column(Column::Colour, 0);
        let want = 0.2 / (0.75 + DAMPING_PX);
        assert!((red[0] * Y00 - want).abs() < 1e-6, "{}", red[0] * Y00);
        assert_eq!(red[1], 0.0);
        assert!(
            (0.5 + red[2] * Y00 - DARKEST).abs() < 1e-6,
            "a colour keeps its gradient"
        );
        assert_eq!(splats.column(Column::Colour, 1), [0.0; 3]);
    }
}
