//! Scale, focal length and principal point that explain flow best.

use super::reading::Reading;
use super::samples::Pair;
use m4_core::{
    Camera, median,
    nalgebra::{Matrix4, Vector4},
};

/// Rounds of reweighting.
const ROUNDS: usize = 4;
/// Steps of the central differences: shares of scale and focal length, pixels.
const STEPS: [f64; 4] = [1e-4, 1e-4, 0.02, 0.02];

/// Corrections of a reading, with standard deviations that count every pair of frames as one measurement.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    pub reading: Reading,
    /// Logarithm of the scale of depth, of that of the focal length, shift of the principal point in pixels.
    pub by: [f64; 4],
    pub sigma: [f64; 4],
}

fn moved(reading: &Reading, by: &Vector4<f64>) -> Reading {
    Reading {
        scale: reading.scale * by[0].exp(),
        focal: reading.focal * by[1].exp(),
        shift_px: [reading.shift_px[0] + by[2], reading.shift_px[1] + by[3]],
        ..*reading
    }
}

/// Fits around `start`; `None` where the samples do not determine all four.
pub(super) fn fit(start: &Reading, cameras: &[Camera], pairs: &[Pair]) -> Option<Fit> {
    let mut by = Vector4::zeros();
    let mut last = None;
    for _ in 0..ROUNDS {
        let here = moved(start, &by);
        let (normal, gradients) = equations(&here, cameras, pairs)?;
        let inverse = normal.cholesky()?.inverse();
        let gradient: Vector4<f64> = gradients.iter().sum();
        let step = -(inverse * gradient);
        if !step.iter().all(|v| v.is_finite()) {
            return None;
        }
        let spread: Matrix4<f64> = gradients.iter().map(|g| g * g.transpose()).sum();
        let covariance = inverse * spread * inverse;
        last = Some(covariance.diagonal().map(|v| v.max(0.0).sqrt()));
        by += step;
    }
    let sigma = last?;
    Some(Fit {
        reading: moved(start, &by),
        by: by.into(),
        sigma: sigma.into(),
    })
}

/// The normal matrix, and the gradient of each pair.
fn equations(here: &Reading, cameras: &[Camera], pairs: &[Pair]) -> Option<(Matrix4<f64>, Vec<Vector4<f64>>)> {
    let mut lengths = super::reading::errors(here, cameras, pairs);
    let huber = 1.5 * median(&mut lengths).filter(|m| m.is_finite())?.max(0.02);
    let mut normal = Matrix4::identity() * 1e-9;
    let mut gradients = Vec::with_capacity(pairs.len());
    for pair in pairs {
        let at = |k: usize, sign: f64| {
            let mut by = Vector4::zeros();
            by[k] = sign * STEPS[k];
            let reading = moved(here, &by);
            (reading.between(cameras, pair), reading.scale)
        };
        let middle = here.between(cameras, pair);
        let sides: [_; 4] = std::array::from_fn(|k| (at(k, 1.0), at(k, -1.0)));
        let mut gradient = Vector4::zeros();
        for s in &pair.samples {
            let Some(r) = middle.error(s, here.scale) else {
                continue;
            };
            let length = r[0].hypot(r[1]);
            // beyond ten times the usual it is no measurement of this camera
            if length > 10.0 * huber {
                continue;
            }
            let weight = if length > huber { huber / length } else { 1.0 };
            let mut rows = [Vector4::zeros(); 2];
            let mut whole = true;
            for (k, (up, down)) in sides.iter().enumerate() {
                match (up.0.error(s, up.1), down.0.error(s, down.1)) {
                    (Some(p), Some(m)) => {
                        for c in 0..2 {
                            rows[c][k] = (p[c] - m[c]) / (2.0 * STEPS[k]);
                        }
                    }
                    _ => whole = false,
                }
            }
            if whole {
                for c in 0..2 {
                    normal += rows[c] * rows[c].transpose() * weight;
                    gradient += rows[c] * (weight * r[c]);
                }
            }
        }
        gradients.push(gradient);
    }
    Some((normal, gradients))
}
