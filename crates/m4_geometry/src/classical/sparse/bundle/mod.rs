//! Bundle adjustment: poses, points and one shared lens that explain all observations.
//!
//! Residual of a point `X` seen at `u` (pixels from the principal point) by a camera `R, T`:
//! `r = bend(f p_xy / p_z) - u` with `p = R X + T`, loss `c^2/2 log(1 + w |r|^2 / c^2)` (Cauchy),
//! `w` the weight of the point, `bend` the distortion of the lens. Unknowns are twists
//! `(tau, omega)` on the left of every pose but the first, the logarithm of `f`, the coefficient of
//! `bend`, and `X`. Points are eliminated (Schur complement); the reduced system is solved by a
//! Cholesky factorisation that skips what lies before the first non-zero of each row.

mod system;

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

#[cfg(test)]
mod tests {
    use super::{Bend, Bundle, BundleOptions, Jacobian, Observation, project};
    use m4_core::{
        CounterRng, Se3, Silent, Sim3, exp_so3,
        nalgebra::{Vector3, Vector6},
    };

    /// Eight cameras on an arc around 60 points, all seen everywhere, every tenth sighting wrong.
    fn scene() -> Bundle {
        let mut rng = CounterRng::new(11, 0, 0);
        let poses: Vec<Se3<f64>> = (0..8)
            .map(|i| Se3 {
                rotation: exp_so3(&Vector3::new(
                    0.02,
                    0.08 * f64::from(i),
                    0.01 * f64::from(i),
                )),
                translation: Vector3::new(0.05 * f64::from(i), 0.0, 5.0),
            })
            .collect();
        let points: Vec<Vector3<f64>> = (0..60)
            .map(|_| Vector3::from_fn(|_, _| 1.2 * rng.normal()))
            .collect();
        let mut observations = Vec::new();
        for (point, x) in points.iter().enumerate() {
            for (pose, w2c) in poses.iter().enumerate() {
                let p = w2c.transform(x);
                let off = if observations.len() % 10 == 9 {
                    30.0 * rng.normal()
                } else {
                    0.0
                };
                observations.push(Observation {
                    pose,
                    point,
                    at: [400.0 * p.x / p.z + off, 400.0 * p.y / p.z],
                });
            }
        }
        Bundle {
            weights: vec![1.0; points.len()],
            poses,
            points,
            log_focal: 400.0_f64.ln(),
            bend: Bend::NONE,
            observations,
        }
    }

    fn options(free_focal: bool) -> BundleOptions {
        BundleOptions {
            cauchy_px: 1.0,
            iterations: 60,
            tolerance: 1e-9,
            free_focal,
            free_bend: false,
        }
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
        assert!(
            (bundle.focal() / 400.0 - 1.0).abs() < 2e-3,
            "{}",
            bundle.focal()
        );
        let fit = Sim3::umeyama(&bundle.points, &truth.points).expect("a cloud");
        let worst = bundle
            .points
            .iter()
            .zip(&truth.points)
            .map(|(a, b)| (fit.transform(a) - b).norm())
            .fold(0.0, f64::max);
        assert!(worst < 0.02, "{worst}");
        assert!(
            report.log_focal_sigma > 1e-4 && report.log_focal_sigma < 0.05,
            "{report:?}"
        );
        assert_eq!(bundle.poses[0], truth.poses[0]);
    }

    #[test]
    fn a_free_coefficient_explains_a_lens_that_bends() {
        let mut bundle = scene();
        let bend = Bend {
            coefficient: -0.25,
            radius_px: 400.0,
        };
        for o in &mut bundle.observations {
            o.at = bend.distorted(o.at).expect("barrels show all");
        }
        let straight = bundle.clone().adjust(&options(true), &Silent);
        bundle.bend = Bend {
            coefficient: 0.0,
            ..bend
        };
        let free = BundleOptions {
            free_bend: true,
            ..options(true)
        };
        let report = bundle.adjust(&free, &Silent);
        let coefficient = bundle.bend.coefficient;
        assert!((coefficient + 0.25).abs() < 5e-3, "{coefficient}");
        assert!(
            (bundle.focal() / 400.0 - 1.0).abs() < 5e-3,
            "{}",
            bundle.focal()
        );
        assert!(report.cost < straight.cost, "{report:?} {straight:?}");
        assert!(
            report.bend_sigma > 1e-5 && report.bend_sigma < 0.05,
            "{report:?}"
        );
        assert_eq!(straight.bend_sigma, f64::INFINITY);
    }

    #[test]
    fn a_fixed_focal_length_stays_and_cost_never_rises() {
        let mut bundle = scene();
        bundle.log_focal += 0.05;
        let before = bundle.cost(&options(false)) / bundle.observations.len() as f64;
        let focal = bundle.log_focal;
        let report = bundle.adjust(&options(false), &Silent);
        assert!(report.cost < before && report.log_focal_sigma.is_infinite());
        assert_eq!(bundle.log_focal, focal);
    }

    #[test]
    fn nothing_to_adjust_is_no_error() {
        let mut bundle = Bundle {
            poses: Vec::new(),
            points: Vec::new(),
            weights: Vec::new(),
            log_focal: 6.0,
            bend: Bend::NONE,
            observations: Vec::new(),
        };
        assert_eq!(bundle.adjust(&options(true), &Silent).cost, 0.0);
    }

    #[test]
    fn derivatives_match_central_differences() {
        let pose = Se3 {
            rotation: exp_so3(&Vector3::new(0.3, -0.5, 0.2)),
            translation: Vector3::new(0.2, -0.4, 3.0),
        };
        let (x, focal, at) = (Vector3::new(0.7, -0.3, 1.1), 420.0_f64, [30.0, -12.0]);
        // A huge scale makes all weights 1.
        let bend = Bend {
            coefficient: -0.2,
            radius_px: 300.0,
        };
        let j = Jacobian::new(&pose, &x, focal, bend, at, 1e9);
        // Variables 0 to 5: the pose, 6 to 8: the point, 9: the logarithm of the focal length, 10:
        // the coefficient of the distortion.
        let moved = |k: usize, h: f64| {
            let step = |from: usize| move |i: usize, _: usize| if from + i == k { h } else { 0.0 };
            let focal = if k == 9 { focal * h.exp() } else { focal };
            let coefficient = bend.coefficient + if k == 10 { h } else { 0.0 };
            let bend = Bend {
                coefficient,
                ..bend
            };
            project(
                &pose.retract(&Vector6::from_fn(step(0))),
                &(x + Vector3::from_fn(step(6))),
                focal,
                bend,
                at,
            )
        };
        let h = 1e-6;
        for k in 0..11 {
            let (a, b) = (
                moved(k, h).expect("in front"),
                moved(k, -h).expect("in front"),
            );
            for i in 0..2 {
                let want = match k {
                    0..6 => j.pose[(i, k)],
                    6..9 => j.point[(i, k - 6)],
                    _ => j.lens[k - 9][i],
                };
                assert!(
                    ((a[i] - b[i]) / (2.0 * h) - want).abs() < 1e-4,
                    "variable {k}, component {i}"
                );
            }
        }
    }

    #[test]
    fn behind_the_camera_nothing_pulls() {
        let j = Jacobian::new(
            &Se3::identity(),
            &Vector3::new(0.0, 0.0, -1.0),
            400.0,
            Bend::NONE,
            [0.0, 0.0],
            1.0,
        );
        assert_eq!(
            (j.residual.norm(), j.pose.norm(), j.point.norm()),
            (0.0, 0.0, 0.0)
        );
    }
}
