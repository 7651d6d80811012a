//! The source camera path, smoothed.
//!
//! At every time a linear motion is fitted to the poses around it, weighted by a Gaussian of time;
//! its value there is the smoothed pose. Inside the clip that is Gaussian smoothing; at the ends, where
//! one side is missing, it neither lags nor contracts. The distance from the source is limited by
//! `d / (1 + (d / limit)^8)^(1/8)`, which is smooth and hardly changes distances well below the limit.

use super::SourcePath;
use crate::render::spline::{PoseSpline, quaternion};
use m4_core::{
    Se3,
    nalgebra::{UnitQuaternion, Vector3},
};

/// Samples a second that are smoothed.
const RATE_HZ: f64 = 60.0;
/// Most samples: five minutes; longer clips are sampled less often.
const MAX_SAMPLES: f64 = 18_000.0;
/// Half width of the window, standard deviations.
const WINDOW_SIGMAS: f64 = 3.0;

/// The parameters of the smoothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Smoothing {
    /// Standard deviation, seconds.
    pub sigma_s: f64,
    /// From 0, the source, to 1.
    pub strength: f64,
    /// Furthest from the source, world units.
    pub stray: f64,
    /// Furthest from the direction of the source, radians.
    pub stray_rad: f64,
}

/// The smoothed poses of the source, by moment (frames).
#[must_use]
pub fn stabilised(source: &SourcePath, how: &Smoothing) -> PoseSpline {
    let (first, last) = source.span();
    let seconds = source.seconds();
    let steps = (seconds * RATE_HZ).ceil().clamp(1.0, MAX_SAMPLES);
    let count = if seconds > 0.0 { steps as usize + 1 } else { 1 };
    let times: Vec<f64> = (0..count).map(|i| first + (last - first) * i as f64 / steps).collect();
    let poses: Vec<Se3<f64>> = times.iter().map(|t| source.at(*t).camera.c2w).collect();
    let turns: Vec<UnitQuaternion<f64>> = poses.iter().map(|p| quaternion(&p.rotation)).collect();
    // Standard deviation in samples.
    let sigma = if count > 1 { how.sigma_s / seconds * steps } else { 1.0 };
    let reach = (WINDOW_SIGMAS * sigma).ceil().min(count as f64) as usize;
    let smoothed = (0..count).map(|i| {
        let window = i.saturating_sub(reach)..(i + reach + 1).min(count);
        let mut line = Line::default();
        for j in window {
            let x = j as f64 - i as f64;
            let turn = (turns[i].inverse() * turns[j]).scaled_axis();
            let way = poses[j].translation - poses[i].translation;
            line.add(x, (-0.5 * (x / sigma).powi(2)).exp(), way, turn);
        }
        let (way, turn) = line.middle();
        let way = limited(way, how.stray) * how.strength;
        let turn = limited(turn, how.stray_rad) * how.strength;
        Se3 {
            rotation: (turns[i] * UnitQuaternion::from_scaled_axis(turn))
                .to_rotation_matrix()
                .into_inner(),
            translation: poses[i].translation + way,
        }
    });
    let smoothed = smoothed.collect();
    PoseSpline::new(times, smoothed)
}

fn limited(d: Vector3<f64>, limit: f64) -> Vector3<f64> {
    d / (1.0 + (d.norm() / limit).powi(8)).powf(0.125)
}

/// Sums of a weighted least-squares line.
#[derive(Default)]
struct Line {
    weight: f64,
    x: f64,
    xx: f64,
    y: [Vector3<f64>; 2],
    xy: [Vector3<f64>; 2],
}

impl Line {
    fn add(&mut self, x: f64, weight: f64, way: Vector3<f64>, turn: Vector3<f64>) {
        self.weight += weight;
        self.x += weight * x;
        self.xx += weight * x * x;
        for (k, y) in [way, turn].into_iter().enumerate() {
            self.y[k] += y * weight;
            self.xy[k] += y * (weight * x);
        }
    }

    /// Returns the value of the line at 0.
    fn middle(&self) -> (Vector3<f64>, Vector3<f64>) {
        let d = self.weight * self.xx - self.x * self.x;
        let at = |k: usize| {
            if d > 1e-12 * self.weight * self.weight {
                (self.y[k] * self.xx - self.xy[k] * self.x) / d
            } else {
                self.y[k] / self.weight
            }
        };
        (at(0), at(1))
    }
}
