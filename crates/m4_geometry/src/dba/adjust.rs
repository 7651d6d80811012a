//! The fast path: Gauss-Newton iterations over f32 planes, the product's solver; gathering, damping
//! and factorisation of the reduced system of all poses.

use super::lanes::Rays;
use super::options::{DbaOptions, DbaReport};
use super::problem::{DbaError, Factor, Geometry, Problem};
use super::source::{Context, Source, SourceSums};
use fearless_simd::Level;
use m4_core::Se3;
use m4_core::nalgebra::{Cholesky, DMatrix, DVector, Vector6};
use rayon::prelude::*;
use std::ops::Range;

/// Sources whose shares exist at the same time: bounds memory.
const SOURCES_AT_ONCE: usize = 64;

/// The edges by source frame, ascending; within a source in the order given.
pub(super) fn by_source<'a>(edges: &[&'a Factor<f32>], frames: usize) -> Vec<Source<'a>> {
    let mut all: Vec<Source<'a>> = (0..frames)
        .map(|frame| Source {
            frame,
            edges: Vec::new(),
        })
        .collect();
    for &edge in edges {
        all[edge.source].edges.push(edge);
    }
    all.retain(|s| !s.edges.is_empty());
    all
}

/// Moves poses, disparities and focal length towards what the edges say. `window` holds the frames
/// whose poses move; the disparities of every source frame move where `options.free` says so. The
/// result does not depend on the number of threads.
///
/// # Errors
///
/// [`DbaError`] where sizes or indices do not fit.
pub fn adjust(
    geometry: &mut Geometry<f32>,
    problem: &Problem<'_, f32>,
    window: Range<usize>,
    options: &DbaOptions,
) -> Result<DbaReport, DbaError> {
    adjust_on(Level::new(), geometry, problem, window, options)
}

/// [`adjust`] with the instructions of `level`.
pub(super) fn adjust_on(
    level: Level,
    geometry: &mut Geometry<f32>,
    problem: &Problem<'_, f32>,
    window: Range<usize>,
    options: &DbaOptions,
) -> Result<DbaReport, DbaError> {
    problem.check(geometry, &window)?;
    let sources = by_source(problem.edges, geometry.frames());
    let mut report = DbaReport::default();
    for _ in 0..options.iterations {
        report.iterations += 1;
        let context = Context {
            geometry,
            eta: problem.eta,
            rays: Rays::new(geometry.grid, &geometry.lens),
            options,
            level,
        };
        let mut system = System::new(window.clone(), options.free.focal());
        for group in sources.chunks(SOURCES_AT_ONCE) {
            let parts: Vec<_> = group.par_iter().map(|s| s.reduce(&context)).collect();
            for part in &parts {
                system.add(part);
            }
        }
        report.rms_px = system.rms_px();
        let Some(step) = system.solve(geometry.frames(), options) else {
            report.failed += 1;
            continue;
        };
        let disparity: Vec<(usize, Vec<f32>)> = if options.free.depth() {
            let steps = sources.par_iter();
            steps
                .map(|s| (s.frame, s.substitute(&context, &step.twists, step.focal)))
                .collect()
        } else {
            Vec::new()
        };
        for (frame, plane) in disparity {
            geometry.disparity[frame] = plane;
        }
        for frame in window.clone() {
            geometry.poses[frame] = Se3::exp(&step.twists[frame]).compose(&geometry.poses[frame]);
        }
        if options.free.focal() {
            geometry.lens = geometry.lens.with_focal_step(step.focal);
        }
    }
    Ok(report)
}

/// Columns that are factorised at once: what follows them is products of matrices.
const BLOCK: usize = 64;

/// The normal equations of the free poses (six each) and, last, of the focal parameter.
pub(super) struct System {
    window: Range<usize>,
    focal: bool,
    /// Lower triangle.
    matrix: DMatrix<f64>,
    rhs: DVector<f64>,
    diagonal: Vec<f64>,
    /// Sums of `w |r|^2` and of `w`.
    squares: (f64, f64),
}

/// A step: the twist of every frame, zero for fixed ones, and of the focal parameter.
pub(super) struct Step {
    pub twists: Vec<Vector6<f64>>,
    pub focal: f64,
}

impl System {
    pub(super) fn new(window: Range<usize>, focal: bool) -> Self {
        let size = 6 * window.len() + usize::from(focal);
        Self {
            window,
            focal,
            matrix: DMatrix::zeros(size, size),
            rhs: DVector::zeros(size),
            diagonal: vec![0.0; size],
            squares: (0.0, 0.0),
        }
    }

    /// Number of unknowns.
    fn size(&self) -> usize {
        self.diagonal.len()
    }

    /// Adds the share of a source. Called in the order of the sources: sums do not depend on
    /// threads.
    pub(super) fn add(&mut self, part: &SourceSums) {
        let mut groups: Vec<(usize, usize, usize)> = part
            .frames
            .iter()
            .enumerate()
            .filter(|&(_, &frame)| self.window.start <= frame && frame < self.window.end)
            .map(|(k, &frame)| (6 * k, 6 * (frame - self.window.start), 6))
            .collect();
        if self.focal {
            groups.push((6 * part.frames.len(), 6 * self.window.len(), 1));
        }
        for &(from, to, rows) in &groups {
            for a in 0..rows {
                self.rhs[to + a] += part.rhs[from + a];
                self.diagonal[to + a] += part.diagonal[from + a];
            }
            for &(other_from, other_to, columns) in &groups {
                if other_to > to {
                    continue;
                }
                for b in 0..columns {
                    for a in 0..rows {
                        self.matrix[(to + a, other_to + b)] +=
                            part.matrix[(from + a, other_from + b)];
                    }
                }
            }
        }
        self.squares.0 += part.squares.0;
        self.squares.1 += part.squares.1;
    }

    /// Root mean square of the weighted residuals, pixels.
    pub(super) fn rms_px(&self) -> f64 {
        if self.squares.1 > 0.0 {
            (self.squares.0 / self.squares.1).sqrt()
        } else {
            0.0
        }
    }

    /// Damps and solves; `None` where the matrix is not positive definite.
    pub(super) fn solve(mut self, frames: usize, options: &DbaOptions) -> Option<Step> {
        let n = self.size();
        let mut step = Step {
            twists: vec![Vector6::zeros(); frames],
            focal: 0.0,
        };
        if n == 0 {
            return Some(step);
        }
        for i in 0..n {
            self.matrix[(i, i)] += options.ep + options.lm * self.diagonal[i];
        }
        #[cfg(test)]
        if options.python_twin && !options.free.depth() {
            for i in 0..n {
                for j in (i % 6..i).step_by(6) {
                    self.matrix[(i, j)] += options.ep + options.lm * self.matrix[(i, j)];
                }
            }
        }
        cholesky_solve(&mut self.matrix, &mut self.rhs)?;
        let x = &self.rhs;
        for (k, frame) in self.window.clone().enumerate() {
            step.twists[frame] = Vector6::from_fn(|a, _| x[6 * k + a]);
        }
        if self.focal {
            step.focal = x[n - 1];
        }
        let finite =
            step.focal.is_finite() && step.twists.iter().all(|t| t.iter().all(|x| x.is_finite()));
        finite.then_some(step)
    }
}

/// Solves with the lower triangle of `matrix`, which becomes its factor: a blocked Cholesky
/// decomposition (Golub and Van Loan, "Matrix Computations", 4.2.9). `None` where the matrix is not
/// positive definite. On one thread: with more, the order of sums would depend on how many there
/// are.
fn cholesky_solve(matrix: &mut DMatrix<f64>, rhs: &mut DVector<f64>) -> Option<()> {
    let n = matrix.nrows();
    for start in (0..n).step_by(BLOCK) {
        let width = BLOCK.min(n - start);
        let next = start + width;
        let factor =
            Cholesky::new(matrix.view((start, start), (width, width)).into_owned())?.unpack_dirty();
        matrix
            .view_mut((start, start), (width, width))
            .copy_from(&factor);
        let mut panel = matrix.view((next, start), (n - next, width)).transpose();
        if !factor.solve_lower_triangular_mut(&mut panel) {
            return None;
        }
        let below = panel.transpose();
        matrix
            .view_mut((next, start), (n - next, width))
            .copy_from(&below);
        for column in (next..n).step_by(BLOCK) {
            let columns = BLOCK.min(n - column);
            let rows = below.rows(column - next, n - column);
            matrix
                .view_mut((column, column), (n - column, columns))
                .gemm(-1.0, &rows, &panel.columns(column - next, columns), 1.0);
        }
    }
    let solved =
        matrix.solve_lower_triangular_mut(rhs) && matrix.ad_solve_lower_triangular_mut(rhs);
    solved.then_some(())
}

#[cfg(test)]
mod tests {
    use super::cholesky_solve;
    use m4_core::nalgebra::{DMatrix, DVector};

    #[test]
    fn only_the_lower_triangle_is_read_and_an_indefinite_matrix_is_refused() {
        let n = 150;
        let value = |i: usize, j: usize| {
            if i == j {
                150.0
            } else {
                ((i * 7 + j * 3) as f64).sin()
            }
        };
        let want: Vec<f64> = (0..n).map(|i| (i as f64).cos()).collect();
        let symmetric = |i: usize, j: usize| value(i.max(j), i.min(j));
        let mut b = DVector::from_fn(n, |i, _| {
            (0..n).map(|j| symmetric(i, j) * want[j]).sum::<f64>()
        });
        let mut a = DMatrix::from_fn(n, n, |i, j| if i >= j { value(i, j) } else { f64::NAN });
        cholesky_solve(&mut a, &mut b).expect("positive definite");
        assert!((0..n).all(|i| (b[i] - want[i]).abs() < 1e-10));
        let mut a = DMatrix::from_fn(2, 2, |i, j| if i == j { 1.0 } else { 2.0 });
        assert!(cholesky_solve(&mut a, &mut DVector::zeros(2)).is_none());
    }
}
