//! The normal equations with the points eliminated.

use super::cholesky::{Envelope, Lower};
use super::{Bundle, BundleOptions, Jacobian};
use m4_core::nalgebra::{Matrix3, Matrix6x3, RowVector3, Vector3, Vector6};
use rayon::prelude::*;
use std::ops::Range;

/// Groups of points that are summed apart, then added in order: fixed, so that sums do not depend on
/// the number of threads.
const GROUPS: usize = 8;

/// `S d = rhs` for poses and focal length.
#[derive(Debug)]
pub(super) struct Reduced {
    envelope: Envelope,
    /// First of six columns, per pose; `None` for poses that do not move.
    pub pose_columns: Vec<Option<usize>>,
    /// Column of the logarithm of the focal length.
    pub focal_column: Option<usize>,
    /// Entries within the envelope.
    matrix: Vec<f64>,
    rhs: Vec<f64>,
}

impl Reduced {
    /// The step and the standard deviation of the logarithm of the focal length (infinite when it is
    /// not free); `None` when the system is singular.
    pub fn solve(&self) -> Option<(Vec<f64>, f64)> {
        let factor = Lower::new(&self.envelope, self.matrix.clone()).factorise()?;
        let step = factor.solve(&self.rhs);
        let sigma = self.focal_column.map_or(f64::INFINITY, |c| {
            let mut unit = vec![0.0; self.envelope.rows()];
            unit[c] = 1.0;
            factor.solve(&unit)[c].max(0.0).sqrt()
        });
        step.iter().all(|v| v.is_finite()).then_some((step, sigma))
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
            if let Some(c) = self.focal_column {
                change += j.focal * step[c];
            }
            gain -= j.residual.dot(&change) + 0.5 * change.norm_squared();
        }
        gain
    }
}

/// What one group of points contributes.
struct Part<'a> {
    envelope: &'a Envelope,
    matrix: Vec<f64>,
    rhs: Vec<f64>,
    /// Diagonal before elimination: what damping scales with.
    diagonal: Vec<f64>,
}

impl<'a> Part<'a> {
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
    inverse.iter().all(|x| x.is_finite()).then_some((inverse, g))
}

/// Builds the reduced system at the current state.
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
            let free = used && i != fixed && options.free_poses;
            free.then(|| {
                n += 6;
                n - 6
            })
        })
        .collect();
    let focal_column = options.free_focal.then_some(n);
    n += usize::from(options.free_focal);
    let groups: Vec<&[Range<usize>]> = runs.chunks(runs.len().div_ceil(GROUPS).max(1)).collect();
    let envelope = envelope(bundle, runs, &pose_columns, focal_column, n);
    let parts: Vec<Part<'_>> = groups
        .par_iter()
        .map(|group| {
            let mut part = Part::zero(&envelope);
            for run in group.iter().filter(|run| !run.is_empty()) {
                part.add_point(bundle, jacobians, run.clone(), damping, &pose_columns, focal_column);
            }
            part
        })
        .collect();
    let mut sum = Part::zero(&envelope);
    for part in &parts {
        add(&mut sum.matrix, &part.matrix);
        add(&mut sum.rhs, &part.rhs);
        add(&mut sum.diagonal, &part.diagonal);
    }
    for i in 0..n {
        sum.matrix[envelope.at(i, i)] += damping * sum.diagonal[i] + 1e-12;
    }
    let Part { matrix, rhs, .. } = sum;
    Reduced { envelope, pose_columns, focal_column, matrix, rhs }
}

/// Poses are coupled where one point is seen by both; all are coupled to the focal length.
fn envelope(
    bundle: &Bundle,
    runs: &[Range<usize>],
    pose_columns: &[Option<usize>],
    focal_column: Option<usize>,
    n: usize,
) -> Envelope {
    let mut first: Vec<usize> = (0..n).map(|row| row - row % 6).collect();
    for run in runs {
        let columns = || bundle.observations[run.clone()].iter().filter_map(|o| pose_columns[o.pose]);
        let Some(least) = columns().min() else { continue };
        for row in columns().flat_map(|c| c..c + 6) {
            first[row] = first[row].min(least);
        }
    }
    if let Some(f) = focal_column {
        first[f] = 0;
    }
    Envelope::new(first)
}

fn add(sum: &mut [f64], part: &[f64]) {
    for (s, p) in sum.iter_mut().zip(part) {
        *s += p;
    }
}

impl Part<'_> {
    fn add_point(
        &mut self,
        bundle: &Bundle,
        jacobians: &[Jacobian],
        run: Range<usize>,
        damping: f64,
        pose_columns: &[Option<usize>],
        focal_column: Option<usize>,
    ) {
        let envelope = self.envelope;
        let at = |row: usize, column: usize| envelope.at(row, column);
        let block = point_block(&jacobians[run.clone()], damping);
        let mut cross: Vec<(usize, Matrix6x3<f64>)> = Vec::with_capacity(run.len());
        let mut cross_focal = RowVector3::zeros();
        for (o, j) in bundle.observations[run.clone()].iter().zip(&jacobians[run]) {
            if let Some(f) = focal_column {
                self.matrix[at(f, f)] += j.focal.norm_squared();
                self.diagonal[f] += j.focal.norm_squared();
                self.rhs[f] -= j.focal.dot(&j.residual);
                cross_focal += j.focal.transpose() * j.point;
            }
            let Some(c) = pose_columns[o.pose] else { continue };
            let (square, gradient) = (j.pose.transpose() * j.pose, j.pose.transpose() * j.residual);
            for a in 0..6 {
                for b in 0..=a {
                    self.matrix[at(c + a, c + b)] += square[(a, b)];
                }
                self.diagonal[c + a] += square[(a, a)];
                self.rhs[c + a] -= gradient[a];
            }
            if let Some(f) = focal_column {
                let row = j.focal.transpose() * j.pose;
                for b in 0..6 {
                    self.matrix[at(f, c + b)] += row[b];
                }
            }
            cross.push((c, j.pose.transpose() * j.point));
        }
        let Some((inverse, gradient)) = block else { return };
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
        if let Some(f) = focal_column {
            let y = cross_focal * inverse;
            for (column, other) in &cross {
                let product = y * other.transpose();
                for b in 0..6 {
                    self.matrix[at(f, column + b)] -= product[b];
                }
            }
            self.matrix[at(f, f)] -= y.dot(&cross_focal);
            self.rhs[f] += y.dot(&gradient.transpose());
        }
    }
}

/// The steps of the points, given that of poses and focal length.
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
            let Some((inverse, mut gradient)) = point_block(&jacobians[run.clone()], damping) else {
                return Vector3::zeros();
            };
            for (o, j) in bundle.observations[run.clone()].iter().zip(&jacobians[run.clone()]) {
                if let Some(c) = system.pose_columns[o.pose] {
                    gradient += j.point.transpose() * (j.pose * Vector6::from_fn(|k, _| step[c + k]));
                }
                if let Some(c) = system.focal_column {
                    gradient += j.point.transpose() * j.focal * step[c];
                }
            }
            -(inverse * gradient)
        })
        .collect()
}
