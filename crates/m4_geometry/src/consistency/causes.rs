//! Which misreading explains the samples; scale, focal length and principal point that explain flow best.

use super::Cause;
use super::reading::{Reading, depth_scale, errors};
use super::samples::{Pair, Samples};
use m4_core::nalgebra::{Matrix4, Vector4};
use m4_core::{Camera, median};

/// Another reading of the poses is believed if it takes the error to less than this share.
const CONVINCING: f64 = 0.5;
/// Another unit is believed from this ratio on ...
const UNIT: f64 = 1.1;
/// ... if it takes the error to less than this share.
const UNIT_CONVINCING: f64 = 0.8;
/// Units that people mix up: nearest of these within 5 % is meant.
const UNITS: [f64; 9] = [1e-3, 1e-2, 0.1, 10.0, 100.0, 1e3, 0.3048, 1.0 / 0.3048, 0.0254];
/// A shift is one of half a pixel between these, in both directions.
const HALF_PX: [f64; 2] = [0.3, 0.7];
/// Deviation from nothing at which a shift or a focal length is believed, standard deviations.
const SURE: f64 = 4.0;
/// A focal length is wrong from this share on.
const FOCAL: f64 = 0.03;

/// Whether the pixels that the masks say move fit one reading of the cameras far better than those that rest fit any: the masks are turned
/// round. There must be more of them, as most of a clip is static.
pub(super) fn masks_turned(cameras: &[Camera], samples: &Samples) -> bool {
    let count = |pairs: &[Pair]| pairs.iter().map(|p| p.samples.len()).sum::<usize>();
    if count(&samples.moving) <= count(&samples.resting) {
        return false;
    }
    let least = |pairs: &[Pair]| {
        let (reading, _) = likeliest(cameras, pairs);
        median(&mut errors(&reading, cameras, pairs)).unwrap_or(f64::INFINITY)
    };
    least(&samples.moving) < CONVINCING * least(&samples.resting)
}

/// The likeliest reading, and what of it differs from the one given.
pub(super) fn likeliest(cameras: &[Camera], pairs: &[Pair]) -> (Reading, Vec<Cause>) {
    let error = |reading: &Reading| median(&mut errors(reading, cameras, pairs)).unwrap_or(f64::INFINITY);
    let scaled = |reading: Reading| Reading { scale: depth_scale(&reading, cameras, pairs).unwrap_or(1.0), ..reading };
    let with = |inverted, flipped| scaled(Reading { inverted, flipped, ..Reading::GIVEN });
    let given = with(false, false);
    let mut best = (given, error(&given));
    for other in [with(false, true), with(true, false), with(true, true)] {
        let e = error(&other);
        if e < CONVINCING * best.1 {
            best = (other, e);
        }
    }
    let (mut reading, mut causes) = (best.0, Vec::new());
    if reading.inverted {
        causes.push(Cause::Inverted);
    }
    if reading.flipped {
        causes.push(Cause::Axes);
    }
    let scale = snapped(reading.scale);
    let same = Reading { scale: 1.0, ..reading };
    let other = Reading { scale, ..reading };
    let far = scale.ln().abs() > UNIT.ln();
    if far && error(&other) < UNIT_CONVINCING * error(&same) {
        reading = other;
        causes.push(Cause::DepthUnit { factor: scale });
    } else {
        reading = same;
    }
    if let Some(found) = fit(&reading, cameras, pairs) {
        let sure = |k: usize, least: f64| found.by[k].abs() > least.max(SURE * found.sigma[k]);
        if sure(1, FOCAL.ln_1p()) {
            causes.push(Cause::Focal { factor: found.reading.focal });
            reading.focal = found.reading.focal;
        } else if let [dx, dy] = found.reading.shift_px
            && [dx, dy].iter().all(|d| (HALF_PX[0]..HALF_PX[1]).contains(&d.abs()))
            && sure(2, 0.0)
            && sure(3, 0.0)
        {
            let shift_px = [0.5 * dx.signum(), 0.5 * dy.signum()];
            causes.push(Cause::PixelCentre { shift_px });
            reading.shift_px = shift_px;
        }
    }
    (reading, causes)
}

fn snapped(scale: f64) -> f64 {
    let near = |unit: &&f64| (scale / **unit).ln().abs() < 0.05;
    UNITS.iter().find(near).copied().unwrap_or(scale)
}

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
    Some(Fit { reading: moved(start, &by), by: by.into(), sigma: sigma.into() })
}

/// The normal matrix, and the gradient of each pair.
fn equations(here: &Reading, cameras: &[Camera], pairs: &[Pair]) -> Option<(Matrix4<f64>, Vec<Vector4<f64>>)> {
    let mut lengths = errors(here, cameras, pairs);
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
