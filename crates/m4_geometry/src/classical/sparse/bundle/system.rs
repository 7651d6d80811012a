//! The normal equations with the points eliminated, and Cholesky factorisation within an envelope.

use super::{Bundle, BundleOptions, Jacobian};
use m4_core::nalgebra::{Matrix3, Matrix6x3, RowVector3, Vector3, Vector6};
use rayon::prelude::*;
use std::ops::Range;

/// Groups of points that are summed apart, then added in order: fixed, so that sums do not depend
/// on the number of threads.
const GROUPS: usize = 8;

/// Columns of what all cameras share.
type LensColumns = [Option<usize>; 2];

/// `S d = rhs` for poses and lens.
#[derive(Debug)]
pub(super) struct Reduced {
    envelope: Envelope,
    /// First of six columns, per pose; `None` for poses that do not move.
    pub pose_columns: Vec<Option<usize>>,
    /// Those of the logarithm of the focal length and of the distortion, where they are free.
    pub lens_columns: LensColumns,
    /// Entries within the envelope.
    matrix: Vec<f64>,
    rhs: Vec<f64>,
}

impl Reduced {
    /// The step and the standard deviations of the logarithm of the focal length and of the
    /// distortion (infinite where they are not free); `None` when the system is singular.
    pub fn solve(&self) -> Option<(Vec<f64>, [f64; 2])> {
        let factor = self.envelope.factorise(self.matrix.clone())?;
        let step = self.envelope.solve(&factor, &self.rhs);
        let sigmas = self.lens_columns.map(|column| {
            column.map_or(f64::INFINITY, |c| {
                let mut unit = vec![0.0; self.envelope.rows()];
                unit[c] = 1.0;
                self.envelope.solve(&factor, &unit)[c].max(0.0).sqrt()
            })
        });
        step.iter().all(|v| v.is_finite()).then_some((step, sigmas))
    }

    /// What the quadratic model promises for a step.
    pub fn predicted_gain(
        &self,
        bundle: &Bundle,
        jacobians: &[Jacobian],
        step: &[f64],
        points: &[Vector3<f64>],
    ) -> f64 {
        let mut gain = 0.0;
        for (o, j) in bundle.observations.iter().zip(jacobians) {
            let mut change = j.point * points[o.point];
            if let Some(c) = self.pose_columns[o.pose] {
                change += j.pose * Vector6::from_fn(|k, _| step[c + k]);
            }
            for (c, column) in free(self.lens_columns, &j.lens) {
                change += column * step[c];
            }
            gain -= j.residual.dot(&change) + 0.5 * change.norm_squared();
        }
        gain
    }
}

struct NormalEquations<'a> {
    envelope: &'a Envelope,
    matrix: Vec<f64>,
    rhs: Vec<f64>,
    /// Diagonal before elimination: what damping scales with.
    diagonal: Vec<f64>,
}

impl<'a> NormalEquations<'a> {
    fn zero(envelope: &'a Envelope) -> Self {
        Self {
            envelope,
            matrix: vec![0.0; envelope.entries()],
            rhs: vec![0.0; envelope.rows()],
            diagonal: vec![0.0; envelope.rows()],
        }
    }
}

/// A point's own block, damped and inverted, and its gradient; `None` when it is not observed well
/// enough to move.
fn point_block(jacobians: &[Jacobian], damping: f64) -> Option<(Matrix3<f64>, Vector3<f64>)> {
    let (mut v, mut g) = (Matrix3::zeros(), Vector3::zeros());
    for j in jacobians {
        v += j.point.transpose() * j.point;
        g += j.point.transpose() * j.residual;
    }
    let ridge = 1e-12 * v.trace().max(1e-30);
    for k in 0..3 {
        v[(k, k)] += damping * v[(k, k)] + ridge;
    }
    let inverse = v.try_inverse()?;
    inverse
        .iter()
        .all(|x| x.is_finite())
        .then_some((inverse, g))
}

pub(super) fn reduce(
    bundle: &Bundle,
    jacobians: &[Jacobian],
    runs: &[Range<usize>],
    damping: f64,
    fixed: usize,
    options: &BundleOptions,
) -> Reduced {
    let mut used = vec![false; bundle.poses.len()];
    for o in &bundle.observations {
        used[o.pose] = true;
    }
    let mut n = 0;
    let pose_columns: Vec<Option<usize>> = used
        .iter()
        .enumerate()
        .map(|(i, &used)| {
            (used && i != fixed).then(|| {
                n += 6;
                n - 6
            })
        })
        .collect();
    let lens_columns = [options.free_focal, options.free_bend].map(|free| {
        n += usize::from(free);
        free.then_some(n.wrapping_sub(1))
    });
    let envelope = envelope(bundle, runs, &pose_columns, lens_columns, n);
    let parts: Vec<NormalEquations<'_>> = runs
        .par_chunks(runs.len().div_ceil(GROUPS).max(1))
        .map(|group| {
            let mut part = NormalEquations::zero(&envelope);
            for run in group.iter().filter(|run| !run.is_empty()) {
                part.add_point(
                    bundle,
                    jacobians,
                    run.clone(),
                    damping,
                    &pose_columns,
                    lens_columns,
                );
            }
            part
        })
        .collect();
    let mut sum = NormalEquations::zero(&envelope);
    for part in &parts {
        for (sum, part) in [
            (&mut sum.matrix, &part.matrix),
            (&mut sum.rhs, &part.rhs),
            (&mut sum.diagonal, &part.diagonal),
        ] {
            sum.iter_mut().zip(part).for_each(|(s, p)| *s += p);
        }
    }
    for i in 0..n {
        sum.matrix[envelope.at(i, i)] += damping * sum.diagonal[i] + 1e-12;
    }
    let (matrix, rhs) = (sum.matrix, sum.rhs);
    Reduced {
        envelope,
        pose_columns,
        lens_columns,
        matrix,
        rhs,
    }
}

/// The free ones of the lens, with their columns.
fn free<T: Copy>(
    columns: LensColumns,
    values: &[T; 2],
) -> impl Iterator<Item = (usize, T)> + use<T> {
    let pairs = columns.into_iter().zip(*values);
    pairs.filter_map(|(column, value)| Some((column?, value)))
}

/// Poses are coupled where one point is seen by both; all are coupled to the lens.
fn envelope(
    bundle: &Bundle,
    runs: &[Range<usize>],
    pose_columns: &[Option<usize>],
    lens_columns: LensColumns,
    n: usize,
) -> Envelope {
    let mut first: Vec<usize> = (0..n).map(|row| row - row % 6).collect();
    for run in runs {
        let columns = || {
            bundle.observations[run.clone()]
                .iter()
                .filter_map(|o| pose_columns[o.pose])
        };
        let Some(least) = columns().min() else {
            continue;
        };
        for row in columns().flat_map(|c| c..c + 6) {
            first[row] = first[row].min(least);
        }
    }
    for row in lens_columns.into_iter().flatten() {
        first[row] = 0;
    }
    Envelope::new(first)
}

impl NormalEquations<'_> {
    fn add_point(
        &mut self,
        bundle: &Bundle,
        jacobians: &[Jacobian],
        run: Range<usize>,
        damping: f64,
        pose_columns: &[Option<usize>],
        lens_columns: LensColumns,
    ) {
        let envelope = self.envelope;
        let at = |row: usize, column: usize| envelope.at(row, column);
        let block = point_block(&jacobians[run.clone()], damping);
        let mut cross: Vec<(usize, Matrix6x3<f64>)> = Vec::with_capacity(run.len());
        let mut cross_lens = [RowVector3::zeros(); 2];
        for (o, j) in bundle.observations[run.clone()].iter().zip(&jacobians[run]) {
            for (f, column) in free(lens_columns, &j.lens) {
                self.matrix[at(f, f)] += column.norm_squared();
                self.diagonal[f] += column.norm_squared();
                self.rhs[f] -= column.dot(&j.residual);
            }
            for (cross, column) in cross_lens.iter_mut().zip(&j.lens) {
                *cross += column.transpose() * j.point;
            }
            if let [Some(f), Some(b)] = lens_columns {
                self.matrix[at(b, f)] += j.lens[0].dot(&j.lens[1]);
            }
            let Some(c) = pose_columns[o.pose] else {
                continue;
            };
            let (square, gradient) = (j.pose.transpose() * j.pose, j.pose.transpose() * j.residual);
            for a in 0..6 {
                for b in 0..=a {
                    self.matrix[at(c + a, c + b)] += square[(a, b)];
                }
                self.diagonal[c + a] += square[(a, a)];
                self.rhs[c + a] -= gradient[a];
            }
            for (f, column) in free(lens_columns, &j.lens) {
                let row = column.transpose() * j.pose;
                for b in 0..6 {
                    self.matrix[at(f, c + b)] += row[b];
                }
            }
            cross.push((c, j.pose.transpose() * j.point));
        }
        let Some((inverse, gradient)) = block else {
            return;
        };
        // Observations of a track are in order of time, so columns ascend.
        for (i, (row, w)) in cross.iter().enumerate() {
            let y = w * inverse;
            for (column, other) in &cross[..=i] {
                let product = y * other.transpose();
                for a in 0..6 {
                    // Of the block on the diagonal, the lower half alone is kept.
                    let width = if *column == *row { a + 1 } else { 6 };
                    let begin = at(row + a, *column);
                    let line = &mut self.matrix[begin..begin + width];
                    for (b, entry) in line.iter_mut().enumerate() {
                        *entry -= product[(a, b)];
                    }
                }
            }
            let back = y * gradient;
            for a in 0..6 {
                self.rhs[row + a] += back[a];
            }
        }
        for (f, cross_one) in free(lens_columns, &cross_lens) {
            let y = cross_one * inverse;
            for (column, other) in &cross {
                let product = y * other.transpose();
                for b in 0..6 {
                    self.matrix[at(f, column + b)] -= product[b];
                }
            }
            for (c, other) in free(lens_columns, &cross_lens).filter(|(c, _)| *c <= f) {
                self.matrix[at(f, c)] -= y.dot(&other);
            }
            self.rhs[f] += y.dot(&gradient.transpose());
        }
    }
}

/// The steps of the points, given that of poses and lens.
pub(super) fn substitute(
    bundle: &Bundle,
    jacobians: &[Jacobian],
    runs: &[Range<usize>],
    damping: f64,
    system: &Reduced,
    step: &[f64],
) -> Vec<Vector3<f64>> {
    runs.par_iter()
        .map(|run| {
            let Some((inverse, mut gradient)) = point_block(&jacobians[run.clone()], damping)
            else {
                return Vector3::zeros();
            };
            for (o, j) in bundle.observations[run.clone()]
                .iter()
                .zip(&jacobians[run.clone()])
            {
                if let Some(c) = system.pose_columns[o.pose] {
                    gradient +=
                        j.point.transpose() * (j.pose * Vector6::from_fn(|k, _| step[c + k]));
                }
                for (c, column) in free(system.lens_columns, &j.lens) {
                    gradient += j.point.transpose() * column * step[c];
                }
            }
            -(inverse * gradient)
        })
        .collect()
}

/// Which entries of the lower triangle may differ from zero: those from `first` of a row to its
/// diagonal. A long clip has thousands of rows and hardly any that reach far back.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Envelope {
    first: Vec<usize>,
    /// Where a row begins in the data, and one more for the end.
    begin: Vec<usize>,
}

impl Envelope {
    /// Rows that begin at these columns, none beyond its diagonal.
    fn new(first: Vec<usize>) -> Self {
        let mut begin = Vec::with_capacity(first.len() + 1);
        begin.push(0);
        let mut end = 0;
        for (i, &first) in first.iter().enumerate() {
            end += i + 1 - first.min(i);
            begin.push(end);
        }
        Self { first, begin }
    }

    fn rows(&self) -> usize {
        self.first.len()
    }

    fn entries(&self) -> usize {
        self.begin[self.first.len()]
    }

    /// Where the entry of a row and a column within the envelope lies.
    fn at(&self, row: usize, column: usize) -> usize {
        self.begin[row] + column - self.first[row]
    }

    /// The Cholesky factor of the matrix with these entries; `None` when it is not positive
    /// definite.
    fn factorise(&self, mut data: Vec<f64>) -> Option<Vec<f64>> {
        let Self { first, begin } = self;
        for i in 0..first.len() {
            let (above, rest) = data.split_at_mut(begin[i]);
            // Entry `j` of row `i` is `row[j - fi]`.
            let (fi, row) = (first[i], &mut rest[..begin[i + 1] - begin[i]]);
            for j in fi..i {
                let (fj, other) = (first[j], &above[begin[j]..begin[j + 1]]);
                let from = fi.max(fj);
                let sum = dot(&row[from - fi..j - fi], &other[from - fj..j - fj]);
                row[j - fi] = (row[j - fi] - sum) / other[j - fj];
            }
            let (before, diagonal) = row.split_at_mut(i - fi);
            let pivot = diagonal[0] - dot(before, before);
            if !(pivot > 0.0 && pivot.is_finite()) {
                return None;
            }
            diagonal[0] = pivot.sqrt();
        }
        Some(data)
    }

    fn solve(&self, factor: &[f64], b: &[f64]) -> Vec<f64> {
        let Self { first, begin } = self;
        let mut x = b.to_vec();
        for i in 0..first.len() {
            let (before, diagonal) = factor[begin[i]..begin[i + 1]].split_at(i - first[i]);
            x[i] = (x[i] - dot(before, &x[first[i]..i])) / diagonal[0];
        }
        for i in (0..first.len()).rev() {
            let (before, diagonal) = factor[begin[i]..begin[i + 1]].split_at(i - first[i]);
            x[i] /= diagonal[0];
            let xi = x[i];
            for (x, l) in x[first[i]..i].iter_mut().zip(before) {
                *x -= l * xi;
            }
        }
        x
    }
}

/// Inner product with eight partial sums, which the compiler keeps in one register.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0_f64; 8];
    let (a_chunks, b_chunks) = (a.chunks_exact(8), b.chunks_exact(8));
    let tail: f64 = a_chunks
        .remainder()
        .iter()
        .zip(b_chunks.remainder())
        .map(|(x, y)| x * y)
        .sum();
    for (x, y) in a_chunks.zip(b_chunks) {
        for k in 0..8 {
            sums[k] += x[k] * y[k];
        }
    }
    sums.iter().sum::<f64>() + tail
}

#[cfg(test)]
mod tests {
    use super::Envelope;

    #[test]
    fn a_system_with_an_envelope_is_solved() {
        let n = 23;
        let mut a = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                if i - j < 6 || i == n - 1 {
                    let value = if i == j {
                        20.0 + i as f64
                    } else {
                        ((i * 7 + j * 3) as f64).sin()
                    };
                    (a[i * n + j], a[j * n + i]) = (value, value);
                }
            }
        }
        let want: Vec<f64> = (0..n).map(|i| (i as f64).cos()).collect();
        let b: Vec<f64> = (0..n)
            .map(|i| (0..n).map(|j| a[i * n + j] * want[j]).sum())
            .collect();
        let first = |i: usize| if i == n - 1 { 0 } else { i.saturating_sub(5) };
        let envelope = Envelope::new((0..n).map(first).collect());
        assert_eq!((envelope.rows(), envelope.entries()), (n, 15 + 17 * 6 + n));
        let within = |a: &[f64]| -> Vec<f64> {
            (0..n)
                .flat_map(|i| a[i * n + first(i)..=i * n + i].to_vec())
                .collect()
        };
        assert_eq!(within(&a)[envelope.at(10, 7)], a[10 * n + 7]);
        let factor = envelope.factorise(within(&a)).expect("positive definite");
        let got = envelope.solve(&factor, &b);
        assert!(got.iter().zip(&want).all(|(x, y)| (x - y).abs() < 1e-10));
        a[0] = -1.0;
        assert!(envelope.factorise(within(&a)).is_none());
    }
}
