//! Sums the gradients of several frames.

use m4_kernels::Gradients;
use rayon::prelude::*;

/// Rows a task.
const CHUNK_ROWS: usize = 8192;

/// Adds the rows that `other` touches to `sum`: gradients of the same splats, of two frames. What was touched by either
/// is touched then; sums of camera and background stay those of `sum`, and so does `means2d`, which training does
/// not read. `n_static` rows lack the columns of time.
///
/// Each value is one addition, so the order of the calls alone decides the bits.
pub(crate) fn add_touched(sum: &mut Gradients, other: &Gradients, n_static: usize) {
    let n = sum.touched.len();
    let (old, new) = (&sum.touched, &other.touched);
    for (column, g) in sum.columns.iter_mut().zip(&other.columns) {
        let first = if column.len() == n { 0 } else { n_static };
        let flags = old[first..].par_chunks(CHUNK_ROWS).zip(new[first..].par_chunks(CHUNK_ROWS));
        let values = column.par_chunks_mut(CHUNK_ROWS).zip(g.par_chunks(CHUNK_ROWS));
        values.zip(flags).for_each(|((column, g), (old, new))| {
            // of a long video most chunks lie in other frames
            if new.iter().all(|&t| t == 0) {
                return;
            }
            for (((a, &g), &old), &new) in column.iter_mut().zip(g).zip(old).zip(new) {
                // rows that are not touched hold anything, NaN included
                let before = if old == 0 { 0.0 } else { *a };
                let more = if new == 0 { 0.0 } else { g };
                *a = before + more;
            }
        });
    }
    for (a, &b) in sum.touched.iter_mut().zip(&other.touched) {
        *a |= b;
    }
}

#[cfg(test)]
mod tests {
    use super::add_touched;
    use m4_kernels::Gradients;

    #[test]
    fn batch_gradients_sum_over_touched_rows_only() {
        let gradients = |shared: [f32; 4], late: [f32; 2], touched: [u8; 4]| Gradients {
            columns: vec![shared.to_vec(), late.to_vec()],
            touched: touched.to_vec(),
            ..Gradients::default()
        };
        let nan = f32::NAN;
        let mut sum = gradients([1.0, nan, 3.0, nan], [3.5, nan], [1, 0, 1, 0]);
        let other = gradients([10.0, 20.0, nan, nan], [nan, nan], [1, 1, 0, 0]);
        add_touched(&mut sum, &other, 2);
        assert_eq!(sum.touched, [1, 1, 1, 0]);
        assert_eq!(sum.columns[0][..3], [11.0, 20.0, 3.0]);
        assert_eq!(sum.columns[1][0], 3.5);
        let again = gradients([0.0; 4], [0.25, 8.0], [0, 0, 1, 1]);
        add_touched(&mut sum, &again, 2);
        assert_eq!(sum.columns[1], [3.75, 8.0]);
        assert_eq!(sum.touched, [1; 4]);
    }
}
