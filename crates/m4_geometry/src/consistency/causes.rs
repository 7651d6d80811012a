//! Which misreading explains the samples.

use super::fit::fit;
use super::reading::{Reading, depth_scale, errors};
use super::report::Cause;
use super::samples::{Pair, Samples};
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
    let scaled = |reading: Reading| Reading {
        scale: depth_scale(&reading, cameras, pairs).unwrap_or(1.0),
        ..reading
    };
    let with = |inverted, flipped| {
        scaled(Reading {
            inverted,
            flipped,
            ..Reading::GIVEN
        })
    };
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
            causes.push(Cause::Focal {
                factor: found.reading.focal,
            });
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
