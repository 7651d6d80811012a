//! Ways in which cameras and depth may have been meant.

use super::Cause;
use super::samples::{Pair, Sample};
use m4_core::nalgebra::{Matrix3, Vector3};
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
