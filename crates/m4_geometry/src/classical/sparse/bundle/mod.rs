//! Bundle adjustment: poses, points and one shared lens that explain all observations.
//!
//! Residual of a point `X` seen at `u` (pixels from the principal point) by a camera `R, T`:
//! `r = bend(f p_xy / p_z) - u` with `p = R X + T`, loss `c^2/2 log(1 + w |r|^2 / c^2)` (Cauchy),
//! `w` the weight of the point, `bend` the distortion of the lens. Unknowns are twists
//! `(tau, omega)` on the left of every pose but the first, the logarithm of `f`, the coefficient of
//! `bend`, and `X`. Points are eliminated (Schur complement); the reduced system is solved by a
//! Cholesky factorisation that skips what lies before the first non-zero of each row.

mod system;
#[cfg(test)]
mod tests;

use super::lens::Bend;
use super::rotation::Limits;
use m4_core::{
    Progress, Se3, hat,
    nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Vector2, Vector3, Vector6},
};
use rayon::prelude::*;
use system::{Reduced, reduce, substitute};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Observation {
    pub pose: usize,
    pub point: usize,
    /// Pixels from the principal point.
    pub at: [f64; 2],
}

#[derive(Debug, Clone)]
pub(crate) struct Bundle {
    /// World to camera; the first one with an observation stays where it is.
    pub poses: Vec<Se3<f64>>,
    pub points: Vec<Vector3<f64>>,
    /// Per point: what all squared residuals of its observations count.
    pub weights: Vec<f64>,
    /// Natural logarithm of the focal length in pixels.
    pub log_focal: f64,
    /// Distortion of the lens.
    pub bend: Bend,
    /// Sorted by point.
    pub observations: Vec<Observation>,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct BundleOptions {
    /// Scale of the Cauchy loss, pixels.
    pub cauchy_px: f64,
    /// Steps, rejected ones included.
    pub iterations: usize,
    /// Ends when a step lowers the loss by less than this share.
    pub tolerance: f64,
    pub free_focal: bool,
    /// Whether the coefficient of the distortion is adjusted, too.
    pub free_bend: bool,
}

impl BundleOptions {
    /// Those of the adjustments of a whole map.
    pub fn whole(limits: &Limits, tolerance: f64, free_focal: bool) -> Self {
        Self {
            cauchy_px: limits.cauchy_px,
            iterations: 30,
            tolerance,
            free_focal,
            free_bend: false,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BundleReport {
    /// Mean loss an observation, squared pixels.
    pub cost: f64,
    /// Standard deviation of the logarithm of the focal length, from the curvature at the end and
    /// for residuals of one pixel; infinite when it was not free.
    pub log_focal_sigma: f64,
    /// The same of the coefficient of the distortion.
    pub bend_sigma: f64,
}

impl Bundle {
    pub fn focal(&self) -> f64 {
        self.log_focal.exp()
    }

    /// Levenberg and Marquardt's method with Nielsen's damping rule (1999). It ends at once when
    /// the user asks to stop; what is found then is not to be used.
    pub fn adjust(&mut self, options: &BundleOptions, progress: &dyn Progress) -> BundleReport {
        let runs = point_runs(&self.observations, self.points.len());
        let fixed = self.observations.iter().map(|o| o.pose).min().unwrap_or(0);
        let mut cost = self.cost(options);
        let (mut damping, mut growth) = (1e-4, 2.0);
        let mut sigmas = [f64::INFINITY; 2];
        let mut jacobians = self.linearise(options);
        for _ in 0..options.iterations {
            if progress.cancelled() {
                break;
            }
            let system = reduce(self, &jacobians, &runs, damping, fixed, options);
            let Some((step, deviations)) = system.solve() else {
                damping *= growth;
                growth *= 2.0;
                continue;
            };
            sigmas = deviations;
            let point_steps = substitute(self, &jacobians, &runs, damping, &system, &step);
            let trial = self.moved(&system, &step, &point_steps);
            let trial_cost = trial.cost(options);
            let predicted = system.predicted_gain(self, &jacobians, &step, &point_steps);
            if trial_cost.is_finite() && trial_cost < cost {
                let ratio = if predicted > 0.0 {
                    (cost - trial_cost) / predicted
                } else {
                    0.5
                };
                let small = (cost - trial_cost) < options.tolerance * cost;
                (*self, cost) = (trial, trial_cost);
                damping = (damping * (1.0 - (2.0 * ratio - 1.0).powi(3)).max(1.0 / 3.0)).max(1e-12);
                growth = 2.0;
                if small {
                    break;
                }
                jacobians = self.linearise(options);
            } else {
                damping *= growth;
                growth *= 2.0;
                if damping > 1e12 {
                    break;
                }
            }
        }
        BundleReport {
            cost: cost / self.observations.len().max(1) as f64,
            log_focal_sigma: sigmas[0],
            bend_sigma: sigmas[1],
        }
    }

    fn cost(&self, options: &BundleOptions) -> f64 {
        let focal = self.focal();
        let one = |o: &Observation| {
            let (pose, point) = (&self.poses[o.pose], &self.points[o.point]);
            let r = project(pose, point, focal, self.bend, o.at);
            let squared = r.map_or(BEHIND_PX * BEHIND_PX, |r| r[0] * r[0] + r[1] * r[1]);
            loss(self.weights[o.point] * squared, options.cauchy_px)
        };
        let partials: Vec<f64> = self
            .observations
            .par_chunks(CHUNK)
            .map(|chunk| chunk.iter().map(one).sum())
            .collect();
        partials.iter().sum()
    }

    /// Residuals and derivatives, weighted by the loss.
    fn linearise(&self, options: &BundleOptions) -> Vec<Jacobian> {
        let focal = self.focal();
        let one = |o: &Observation| {
            // loss(w r^2, c) = w loss(r^2, c / sqrt w)
            let root = self.weights[o.point].sqrt();
            Jacobian::new(
                &self.poses[o.pose],
                &self.points[o.point],
                focal,
                self.bend,
                o.at,
                options.cauchy_px / root,
            )
            .scaled(root)
        };
        self.observations.par_iter().map(one).collect()
    }

    fn moved(&self, system: &Reduced, step: &[f64], point_steps: &[Vector3<f64>]) -> Self {
        let mut trial = self.clone();
        for (pose, column) in trial.poses.iter_mut().zip(&system.pose_columns) {
            if let Some(c) = *column {
                *pose = pose.retract(&Vector6::from_fn(|k, _| step[c + k]));
            }
        }
        for (point, d) in trial.points.iter_mut().zip(point_steps) {
            *point += d;
        }
        let [focal, bend] = system.lens_columns;
        if let Some(c) = focal {
            // A factor of 1.3 a step keeps the search from leaping out of the basin.
            trial.log_focal += step[c].clamp(-0.26, 0.26);
        }
        if let Some(c) = bend {
            trial.bend.coefficient += step[c].clamp(-0.1, 0.1);
        }
        trial
    }
}

/// Observations a task handles: fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 1024;

/// Residual that a point behind its camera counts with, pixels.
const BEHIND_PX: f64 = 100.0;

fn loss(squared: f64, scale: f64) -> f64 {
    0.5 * scale * scale * (squared / (scale * scale)).ln_1p()
}

fn point_runs(observations: &[Observation], points: usize) -> Vec<std::ops::Range<usize>> {
    let mut runs = vec![0..0; points];
    let mut begin = 0;
    while begin < observations.len() {
        let point = observations[begin].point;
        let mut end = begin + 1;
        while end < observations.len() && observations[end].point == point {
            end += 1;
        }
        runs[point] = begin..end;
        begin = end;
    }
    runs
}

/// The residual of a point, pixels; `None` when the point is not in front of the camera, or where
/// the lens shows nothing.
pub(super) fn project(
    w2c: &Se3<f64>,
    point: &Vector3<f64>,
    focal: f64,
    bend: Bend,
    at: [f64; 2],
) -> Option<[f64; 2]> {
    let p = w2c.transform(point);
    if p.z <= 1e-6 {
        return None;
    }
    let [u, v] = bend.distorted([focal * p.x / p.z, focal * p.y / p.z])?;
    Some([u - at[0], v - at[1]])
}

/// One observation, linearised and scaled by the root of its weight; all zero for a point that is
/// not in front of the camera.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Jacobian {
    pub residual: Vector2<f64>,
    /// By the twist `(tau, omega)`.
    pub pose: Matrix2x6<f64>,
    /// By the position.
    pub point: Matrix2x3<f64>,
    /// By the logarithm of the focal length, and by the coefficient of the distortion.
    pub lens: [Vector2<f64>; 2],
}

impl Jacobian {
    /// Derivatives of [`project`], weighted for Cauchy's loss of scale `cauchy_px`
    /// (weight `1 / (1 + |r|^2 / c^2)`).
    pub fn new(
        w2c: &Se3<f64>,
        point: &Vector3<f64>,
        focal: f64,
        bend: Bend,
        at: [f64; 2],
        cauchy_px: f64,
    ) -> Self {
        let Some(r) = project(w2c, point, focal, bend, at) else {
            return Self::default();
        };
        let p = w2c.transform(point);
        let (fz, x, y) = (focal / p.z, p.x / p.z, p.y / p.z);
        let mut by_camera = Matrix2x3::new(fz, 0.0, -fz * x, 0.0, fz, -fz * y);
        let mut by_focal = Vector2::new(focal * x, focal * y);
        let by_bend = bend.by_coefficient([focal * x, focal * y]);
        if bend.coefficient != 0.0 {
            let by_pinhole: Matrix2<f64> = bend.by_position([focal * x, focal * y]);
            by_camera = by_pinhole * by_camera;
            by_focal = by_pinhole * by_focal;
        }
        let turn = by_camera * -hat(&p);
        let residual = Vector2::new(r[0], r[1]);
        let scale = (1.0 / (1.0 + residual.norm_squared() / (cauchy_px * cauchy_px))).sqrt();
        let mut pose = Matrix2x6::zeros();
        pose.fixed_view_mut::<2, 3>(0, 0)
            .copy_from(&(by_camera * scale));
        pose.fixed_view_mut::<2, 3>(0, 3).copy_from(&(turn * scale));
        Self {
            residual: residual * scale,
            pose,
            point: by_camera * w2c.rotation * scale,
            lens: [by_focal * scale, by_bend * scale],
        }
    }

    /// Residual and derivatives times `factor`.
    fn scaled(self, factor: f64) -> Self {
        Self {
            residual: self.residual * factor,
            pose: self.pose * factor,
            point: self.point * factor,
            lens: self.lens.map(|column| column * factor),
        }
    }
}
