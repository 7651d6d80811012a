//! Fits colours by least squares: rounds that distribute the residual of each splat's pixels.
//!
//! With everything else fixed an image is `A c + b`: `A` holds the blending weights, at least 0 and
//! of a sum of at most 1 a pixel. A round is `c += (A^T (target - image)) / (A^T 1 + damping)`,
//! splat by splat and channel by channel: the simultaneous iterative reconstruction technique
//! (Gilbert 1972), whose error never grows (docs/spec/optimiser.md 8, item 7). Both sums are what
//! the renderer's backward pass returns, of the residual and of ones.

use m4_core::{Column, Splats};
use rayon::prelude::*;

/// Rows a task.
const CHUNK_ROWS: usize = 8192;
/// Value of the constant spherical harmonic: a coefficient of the colour counts so much.
const Y00: f32 = m4_kernels::shade::C0 as f32;
/// Least colour that a fit leaves, 0..1: at 0 and below a colour has no gradient any more.
const DARKEST: f32 = 0.004;
/// Added to the sum of a splat's weights, pixels over all frames: splats that are hardly seen
/// hardly change (our choice).
const DAMPING_PX: f32 = 0.1;

/// Frames that a fit of `rounds` rounds draws, in units of what a frame of a step costs; `all` are
/// in the capture.
pub(crate) fn frames_drawn(rounds: usize, all: usize) -> f64 {
    match rounds {
        0 => 0.0,
        rounds => all as f64 * (rounds as f64 + 0.5),
    }
}

/// Adds the gradients of a frame with respect to the constant coefficients, one column per channel,
/// to `sums`, `[channel][n]`; rows that are not `touched` hold anything.
pub(crate) fn add_seen(sums: &mut [Vec<f32>; 3], columns: &[Vec<f32>], touched: &[u8]) {
    for (sum, column) in sums.iter_mut().zip(columns) {
        let rows = column
            .par_chunks(CHUNK_ROWS)
            .zip(touched.par_chunks(CHUNK_ROWS));
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

/// Moves the colours, given the sums over the pixels of all frames, `[channel][n]`: of weight times
/// image minus target, and of weights.
pub(crate) fn correct(splats: &mut Splats, residual: &[Vec<f32>; 3], weight: &[Vec<f32>; 3]) {
    let constant = splats.layout().colour_terms() == 1;
    for k in 0..3 {
        let column = splats.column_mut(Column::Colour, k);
        for ((c, &residual), &weight) in column.iter_mut().zip(&residual[k]).zip(&weight[k]) {
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

#[cfg(test)]
mod tests {
    use super::{DAMPING_PX, DARKEST, Y00, add_seen, correct, frames_drawn};
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
        let zero = || [0, 1, 2].map(|_| vec![0.0; 3]);
        let (mut residual, mut weight) = (zero(), zero());
        let nan = f32::NAN;
        // weights 0.5 and 0.25 on two pixels that lack 0.2 and 0.4; the second splat is seen
        // nowhere
        let weights = [0.75 * Y00, nan, 2.0 * Y00];
        let residuals = [-(0.5 * 0.2 + 0.25 * 0.4) * Y00, nan, 4.0 * Y00];
        add_seen(
            &mut weight,
            &[weights.to_vec(), weights.to_vec(), weights.to_vec()],
            &[1, 0, 1],
        );
        add_seen(
            &mut residual,
            &[residuals.to_vec(), vec![0.0; 3], vec![0.0; 3]],
            &[1, 0, 1],
        );
        correct(&mut splats, &residual, &weight);
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
