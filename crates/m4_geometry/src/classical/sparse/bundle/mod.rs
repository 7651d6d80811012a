//! Bundle adjustment: poses, points and one shared focal length that explain all observations.
//!
//! Residual of a point `X` seen at `u` (pixels from the principal point) by a camera `R, T`:
//! `r = f p_xy / p_z - u` with `p = R X + T`, loss `c^2/2 log(1 + |r|^2 / c^2)` (Cauchy). Unknowns
//! are twists `(tau, omega)` on the left of every pose but the first, the logarithm of `f`, and `X`.
//! Points are eliminated (Schur complement); the reduced system is solved by a Cholesky
//! factorisation that skips what lies before the first non-zero of each row.

mod cholesky;
mod jacobian;
mod system;

pub(crate) use jacobian::Jacobian;
use jacobian::project;
use m4_core::{
    Progress, Se3,
    nalgebra::{Vector3, Vector6},
};
use rayon::prelude::*;
use system::{Reduced, reduce, substitute};

/// One sighting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Observation {
    /// Index of the pose.
    pub pose: usize,
    /// Index of the point.
    pub point: usize,
    /// Pixels from the principal point.
    pub at: [f64; 2],
}

/// What is adjusted.
#[derive(Debug, Clone)]
pub(crate) struct Bundle {
    /// World to camera; the first one with an observation stays where it is.
    pub poses: Vec<Se3<f64>>,
    /// World positions.
    pub points: Vec<Vector3<f64>>,
    /// Natural logarithm of the focal length in pixels.
    pub log_focal: f64,
    /// Sorted by point.
    pub observations: Vec<Observation>,
}

/// How it is adjusted.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BundleOptions {
    /// Scale of the Cauchy loss, pixels.
    pub cauchy_px: f64,
    /// Steps, rejected ones included.
    pub iterations: usize,
    /// Ends when a step lowers the loss by less than this share.
    pub tolerance: f64,
    /// False keeps the focal length.
    pub free_focal: bool,
    /// False keeps all poses: points alone move.
    pub free_poses: bool,
}

/// How it went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BundleReport {
    /// Mean loss an observation, squared pixels.
    pub cost: f64,
    /// Standard deviation of the logarithm of the focal length, from the curvature at the end and
    /// for residuals of one pixel; infinite when it was not free.
    pub log_focal_sigma: f64,
}

impl Bundle {
    /// The focal length in pixels.
    pub fn focal(&self) -> f64 {
        self.log_focal.exp()
    }

    /// Levenberg and Marquardt's method with Nielsen's damping rule (1999). It ends at once when the user asks to stop; what
    /// is found then is not to be used.
    pub fn adjust(&mut self, options: &BundleOptions, progress: &dyn Progress) -> BundleReport {
        let runs = point_runs(&self.observations, self.points.len());
        let fixed = self.observations.iter().map(|o| o.pose).min().unwrap_or(0);
        let mut cost = self.cost(options);
        let (mut damping, mut growth) = (1e-4, 2.0);
        let mut log_focal_sigma = f64::INFINITY;
        let mut jacobians = self.linearise(options);
        for _ in 0..options.iterations {
            if progress.cancelled() {
                break;
            }
            let system = reduce(self, &jacobians, &runs, damping, fixed, options);
            let Some((step, sigma)) = system.solve() else {
                damping *= growth;
                growth *= 2.0;
                continue;
            };
            log_focal_sigma = sigma;
            let point_steps = substitute(self, &jacobians, &runs, damping, &system, &step);
            let trial = self.moved(&system, &step, &point_steps);
            let trial_cost = trial.cost(options);
            let predicted = system.predicted_gain(self, &jacobians, &step, &point_steps);
            if trial_cost.is_finite() && trial_cost < cost {
                let ratio = if predicted > 0.0 { (cost - trial_cost) / predicted } else { 0.5 };
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
        BundleReport { cost: cost / self.observations.len().max(1) as f64, log_focal_sigma }
    }

    /// Sum of losses.
    fn cost(&self, options: &BundleOptions) -> f64 {
        let focal = self.focal();
        let partials: Vec<f64> = self
            .observations
            .par_chunks(CHUNK)
            .map(|chunk| {
                chunk
                    .iter()
                    .map(|o| {
                        let r = project(&self.poses[o.pose], &self.points[o.point], focal, o.at);
                        loss(r.map_or(BEHIND_PX * BEHIND_PX, |r| r[0] * r[0] + r[1] * r[1]), options.cauchy_px)
                    })
                    .sum()
            })
            .collect();
        partials.iter().sum()
    }

    /// Residuals and derivatives, weighted by the loss.
    fn linearise(&self, options: &BundleOptions) -> Vec<Jacobian> {
        let focal = self.focal();
        let parts: Vec<Vec<Jacobian>> = self
            .observations
            .par_chunks(CHUNK)
            .map(|chunk| {
                chunk
                    .iter()
                    .map(|o| {
                        let pose = &self.poses[o.pose];
                        Jacobian::new(pose, &self.points[o.point], focal, o.at, options.cauchy_px)
                    })
                    .collect()
            })
            .collect();
        parts.into_iter().flatten().collect()
    }

    /// This bundle after a step.
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
        if let Some(c) = system.focal_column {
            // A factor of 1.3 a step keeps the search from leaping out of the basin.
            trial.log_focal += step[c].clamp(-0.26, 0.26);
        }
        trial
    }
}

/// Observations a task handles: fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 1024;

/// Residual that a point behind its camera counts with, pixels.
const BEHIND_PX: f64 = 100.0;

/// Cauchy's loss of a squared residual.
fn loss(squared: f64, scale: f64) -> f64 {
    0.5 * scale * scale * (squared / (scale * scale)).ln_1p()
}

/// The range of observations of every point.
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

#[cfg(test)]
mod tests {
    use super::{Bundle, BundleOptions, Observation};
    use m4_core::{
        CounterRng, Se3, Silent, Sim3, exp_so3,
        nalgebra::{Vector3, Vector6},
    };

    /// Eight cameras on an arc around 60 points, all seen everywhere, every tenth sighting wrong.
    fn scene() -> Bundle {
        let mut rng = CounterRng::new(11, 0, 0);
        let poses: Vec<Se3<f64>> = (0..8)
            .map(|i| Se3 {
                rotation: exp_so3(&Vector3::new(0.02, 0.08 * f64::from(i), 0.01 * f64::from(i))),
                translation: Vector3::new(0.05 * f64::from(i), 0.0, 5.0),
            })
            .collect();
        let points: Vec<Vector3<f64>> = (0..60).map(|_| Vector3::from_fn(|_, _| 1.2 * rng.normal())).collect();
        let mut observations = Vec::new();
        for (point, x) in points.iter().enumerate() {
            for (pose, w2c) in poses.iter().enumerate() {
                let p = w2c.transform(x);
                let off = if observations.len() % 10 == 9 { 30.0 * rng.normal() } else { 0.0 };
                observations.push(Observation { pose, point, at: [400.0 * p.x / p.z + off, 400.0 * p.y / p.z] });
            }
        }
        Bundle { poses, points, log_focal: 400.0_f64.ln(), observations }
    }

    fn options(free_focal: bool) -> BundleOptions {
        BundleOptions { cauchy_px: 1.0, iterations: 60, tolerance: 1e-9, free_focal, free_poses: true }
    }

    #[test]
    fn poses_points_and_focal_length_return_to_the_truth() {
        let truth = scene();
        let mut rng = CounterRng::new(12, 0, 0);
        let mut bundle = truth.clone();
        for pose in bundle.poses.iter_mut().skip(1) {
            *pose = pose.retract(&Vector6::from_fn(|_, _| 0.01 * rng.normal()));
        }
        for point in &mut bundle.points {
            *point += Vector3::from_fn(|_, _| 0.03 * rng.normal());
        }
        bundle.log_focal += 0.08;
        let report = bundle.adjust(&options(true), &Silent);
        assert!((bundle.focal() / 400.0 - 1.0).abs() < 2e-3, "{}", bundle.focal());
        let fit = Sim3::umeyama(&bundle.points, &truth.points).expect("a cloud");
        let worst =
            bundle.points.iter().zip(&truth.points).map(|(a, b)| (fit.transform(a) - b).norm()).fold(0.0, f64::max);
        assert!(worst < 0.02, "{worst}");
        assert!(report.log_focal_sigma > 1e-4 && report.log_focal_sigma < 0.05, "{report:?}");
        assert_eq!(bundle.poses[0], truth.poses[0]);
    }

    #[test]
    fn fixed_parameters_stay_and_cost_never_rises() {
        let mut bundle = scene();
        bundle.log_focal += 0.05;
        let before = bundle.cost(&options(false)) / bundle.observations.len() as f64;
        let (focal, poses) = (bundle.log_focal, bundle.poses.clone());
        let held = BundleOptions { free_poses: false, ..options(false) };
        let report = bundle.adjust(&held, &Silent);
        assert!(report.cost < before && report.log_focal_sigma.is_infinite());
        assert_eq!((bundle.log_focal, &bundle.poses), (focal, &poses));
    }

    #[test]
    fn nothing_to_adjust_is_no_error() {
        let mut bundle = Bundle { poses: Vec::new(), points: Vec::new(), log_focal: 6.0, observations: Vec::new() };
        assert_eq!(bundle.adjust(&options(true), &Silent).cost, 0.0);
    }
}
