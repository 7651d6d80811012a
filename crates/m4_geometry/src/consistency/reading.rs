//! Ways in which cameras and depth may have been meant, and which of them explains the samples: scale, focal length and principal
//! point that explain flow best.

use super::Cause;
use super::samples::{Pair, Sample, Samples};
use m4_core::nalgebra::{Matrix3, Matrix4, Vector3, Vector4};
use m4_core::{Camera, Capture, CompactDepth, CompactMask, DepthMap, Se3, median};

/// How far a point goes by the translation alone for its depth to be told, pixels.
const PARALLAX_PX: f64 = 2.0;
/// Fewest samples from which a scale is estimated.
const LEAST_SAMPLES: usize = 50;

/// One way to read the files.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reading {
    /// The poses are world to camera.
    pub inverted: bool,
    /// The cameras' y and z axes point the other way.
    pub flipped: bool,
    /// What depth is multiplied by.
    pub scale: f64,
    /// What focal lengths are multiplied by.
    pub focal: f64,
    /// What is added to principal points, pixels.
    pub shift_px: [f64; 2],
}

impl Reading {
    pub const GIVEN: Self = Self { inverted: false, flipped: false, scale: 1.0, focal: 1.0, shift_px: [0.0; 2] };

    pub fn c2w(&self, given: &Se3<f64>) -> Se3<f64> {
        let mut c2w = if self.inverted { given.inverse() } else { *given };
        if self.flipped {
            c2w.rotation.column_mut(1).neg_mut();
            c2w.rotation.column_mut(2).neg_mut();
        }
        c2w
    }

    pub fn camera(&self, given: &Camera) -> Camera {
        let mut camera = *given;
        camera.c2w = self.c2w(&given.c2w);
        camera.intrinsics.fx *= self.focal;
        camera.intrinsics.fy *= self.focal;
        camera.intrinsics.cx += self.shift_px[0];
        camera.intrinsics.cy += self.shift_px[1];
        camera
    }

    /// Between the frames of a pair.
    pub fn between(&self, cameras: &[Camera], pair: &Pair) -> Between {
        let [a, b] = pair.frames.map(|i| self.camera(&cameras[i]));
        let motion = b.w2c().compose(&a.c2w);
        let k = |c: &Camera| {
            let k = &c.intrinsics;
            Matrix3::new(k.fx, 0.0, k.cx, 0.0, k.fy, k.cy, 0.0, 0.0, 1.0)
        };
        let ka = &a.intrinsics;
        let back = Matrix3::new(1.0 / ka.fx, 0.0, -ka.cx / ka.fx, 0.0, 1.0 / ka.fy, -ka.cy / ka.fy, 0.0, 0.0, 1.0);
        Between {
            far: k(&b) * motion.rotation * back,
            near: k(&b) * motion.translation,
            turned: motion.rotation * back,
            moved: motion.translation,
        }
    }
}

/// What takes pixels of one frame to another: `q ~ far (u, v, 1) + near / z`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Between {
    far: Matrix3<f64>,
    near: Vector3<f64>,
    turned: Matrix3<f64>,
    moved: Vector3<f64>,
}

impl Between {
    fn parts(&self, s: &Sample) -> ([f64; 2], [f64; 2]) {
        let a = self.far * Vector3::new(s.from_px[0], s.from_px[1], 1.0);
        let at = |k: usize| (a[k] - s.to_px[k] * a[2], self.near[k] - s.to_px[k] * self.near[2]);
        let ((ax, bx), (ay, by)) = (at(0), at(1));
        ([ax, ay], [bx, by])
    }

    /// One over the depth with which the point comes nearest to where flow took it, and whether it is determined.
    pub fn disparity(&self, s: &Sample) -> (f64, bool) {
        let ([ax, ay], [bx, by]) = self.parts(s);
        let square = bx * bx + by * by;
        if square < 1e-18 {
            return (0.0, false);
        }
        let d = -(ax * bx + ay * by) / square;
        let a2 = (self.far * Vector3::new(s.from_px[0], s.from_px[1], 1.0))[2];
        let depth = (a2 + d * self.near[2]).abs().max(1e-9);
        (d, (d * square.sqrt() / depth).abs() >= PARALLAX_PX)
    }

    /// From where the point is seen, with that disparity, to where flow took it, pixels; `None` behind the camera.
    pub fn residual(&self, s: &Sample, disparity: f64) -> Option<[f64; 2]> {
        let q = self.far * Vector3::new(s.from_px[0], s.from_px[1], 1.0) + self.near * disparity;
        (q[2] > 1e-9).then(|| [q[0] / q[2] - s.to_px[0], q[1] / q[2] - s.to_px[1]])
    }

    /// z-depth of the point in the second frame.
    pub fn depth_there(&self, s: &Sample, z: f64) -> f64 {
        (self.turned * Vector3::new(s.from_px[0], s.from_px[1], 1.0) * z + self.moved)[2]
    }

    /// The residual with the sample's own depth times `scale`, or where none is known with the depth that fits best: what remains is
    /// the distance from the epipolar line then. `None` where the point is behind a camera.
    pub fn error(&self, s: &Sample, scale: f64) -> Option<[f64; 2]> {
        if s.depth[0] > 0.0 {
            return self.residual(s, 1.0 / (s.depth[0] * scale));
        }
        let (d, told) = self.disparity(s);
        if told && d < 0.0 {
            return None;
        }
        self.residual(s, d.max(0.0))
    }
}

/// The scale of depth that brings it nearest to what flow and poses say; `None` where these tell no depth.
pub(super) fn depth_scale(reading: &Reading, cameras: &[Camera], pairs: &[Pair]) -> Option<f64> {
    let mut logs = Vec::new();
    for pair in pairs {
        let between = reading.between(cameras, pair);
        for s in pair.samples.iter().filter(|s| s.depth[0] > 0.0) {
            let (d, told) = between.disparity(s);
            if told && d > 0.0 {
                logs.push(-(d * s.depth[0]).ln());
            }
        }
    }
    (logs.len() >= LEAST_SAMPLES).then(|| median(&mut logs)).flatten().map(f64::exp)
}

/// Lengths of all errors, pixels; infinite for points behind a camera.
pub(super) fn errors(reading: &Reading, cameras: &[Camera], pairs: &[Pair]) -> Vec<f64> {
    let mut out = Vec::new();
    for pair in pairs {
        let between = reading.between(cameras, pair);
        let length = |s| between.error(s, reading.scale).map_or(f64::INFINITY, |[x, y]| x.hypot(y));
        out.extend(pair.samples.iter().map(length));
    }
    out
}

/// By what share depth in the second frame differs from that of the point seen there, where both are known: `|ln|` of the ratio.
pub(super) fn depth_errors(reading: &Reading, cameras: &[Camera], pairs: &[Pair]) -> Vec<f64> {
    let mut out = Vec::new();
    for pair in pairs {
        let between = reading.between(cameras, pair);
        let both = pair.samples.iter().filter(|s| s.depth[0] > 0.0 && s.depth[1] > 0.0);
        out.extend(both.map(|s| {
            let z = between.depth_there(s, s.depth[0] * reading.scale);
            let ratio = z / (s.depth[1] * reading.scale);
            if ratio > 0.0 { ratio.ln().abs() } else { f64::INFINITY }
        }));
    }
    out
}

/// The capture with its causes of inconsistency put right: cameras, depth and masks; images as they are.
#[must_use]
pub fn fixed(mut capture: Capture, causes: &[Cause]) -> Capture {
    let reading = causes.iter().fold(Reading::GIVEN, |reading, cause| match *cause {
        Cause::Masks => reading,
        Cause::Inverted => Reading { inverted: true, ..reading },
        Cause::Axes => Reading { flipped: true, ..reading },
        Cause::DepthUnit { factor } => Reading { scale: factor, ..reading },
        Cause::Focal { factor } => Reading { focal: factor, ..reading },
        Cause::PixelCentre { shift_px } => Reading { shift_px, ..reading },
    });
    let turned = causes.contains(&Cause::Masks);
    for frame in &mut capture.frames {
        if turned {
            frame.mask = frame.mask.take().map(|mask| CompactMask::from(&mask.to_mask().map(|m| 255 - m)));
            frame.motion = frame.motion.take().map(|motion| motion.map(|m| 255 - m));
        }
        frame.camera = reading.camera(&frame.camera);
        if reading.scale != 1.0 {
            frame.depth = frame.depth.take().map(|depth| {
                let scaled: DepthMap = depth.to_map().map(|z| (f64::from(*z) * reading.scale) as f32);
                CompactDepth::from(scaled)
            });
        }
    }
    capture
}

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

/// Whether the pixels that the masks call dynamic fit one reading of the cameras far better than the static ones fit any: the masks are
/// inverted. There must be more of them, as most of a clip is static.
pub(super) fn masks_inverted(cameras: &[Camera], samples: &Samples) -> bool {
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
