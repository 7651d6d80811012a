//! The parabola through the rays to an object, for a given acceleration.

use super::super::ground::Ground;
use super::RigidObject;
use m4_core::Camera;
use nalgebra::{Matrix6, Vector3, Vector6};

/// Fewest frames in which the whole object is seen.
const LEAST: usize = 6;
/// Solutions, each weighted by the depths of the one before.
const SOLUTIONS: usize = 4;
/// Depths that differ from what the object seems to have by more than this factor are a failure.
const RANGE: f64 = 20.0;

/// The trajectory of an object, affine in the acceleration.
#[derive(Debug, Clone)]
pub(super) struct Parabola {
    /// The frame, counted from the object's first, where it is at its place with its velocity.
    middle: f64,
    /// Place and velocity a frame without acceleration, and what an acceleration of 1 adds to them.
    still: Vector6<f64>,
    fall: Vector6<f64>,
    /// Root mean square distance of the middles from it, pixels at the working size.
    pub miss_px: f64,
    /// Frames in which the whole object is seen.
    pub seen: usize,
    /// Standard deviation of the depth for a pixel of noise, as a share of it.
    pub doubt: f64,
    /// The acceleration that would fit best, and one over its variance for a pixel of noise.
    pub best: f64,
    pub sharp: f64,
}

impl Parabola {
    /// Fits the parabola of frames `first..end` at the acceleration `g`; `None` if too little is seen.
    pub fn fit(object: &RigidObject<'_>, (first, end): (usize, usize), ground: &Ground, g: f64) -> Option<Self> {
        let middle = (first + end - 1) as f64 / 2.0;
        let usual = object.depth[first..end].iter().sum::<f64>() / (end - first) as f64;
        let mut z = vec![usual; end - first];
        let mut out = None;
        for _ in 0..SOLUTIONS {
            let parabola = Self::solve(object, (first, middle), &z, ground, g)?;
            for (k, z) in (first..end).zip(&mut z) {
                *z = parabola.depth(&object.cameras[k], k, ground, g);
                if !(*z > usual / RANGE && *z < usual * RANGE) {
                    return None;
                }
            }
            out = Some(parabola);
        }
        out
    }

    /// One solution, `z` being the depths by frame from `first` on.
    fn solve(
        object: &RigidObject<'_>,
        (first, middle): (usize, f64),
        z: &[f64],
        ground: &Ground,
        g: f64,
    ) -> Option<Self> {
        let (mut a, mut still, mut fall) = (Matrix6::zeros(), Vector6::zeros(), Vector6::zeros());
        let mut rows = Vec::new();
        for (i, z) in z.iter().enumerate().filter(|(i, _)| object.observations[first + i].whole) {
            let k = first + i;
            let t = k as f64 - middle;
            let c = object.cameras[k].centre();
            for across in &object.observations[k].across {
                let e = across / *z;
                let mut row = Vector6::zeros();
                row.fixed_rows_mut::<3>(0).copy_from(&e);
                row.fixed_rows_mut::<3>(3).copy_from(&(e * t));
                let (b, d) = (e.dot(&c), -0.5 * t * t * e.dot(&ground.down));
                a += row * row.transpose();
                still += row * b;
                fall += row * d;
                rows.push((row, b, d));
            }
        }
        if rows.len() < 2 * LEAST {
            return None;
        }
        let solver = a.cholesky()?;
        let (still, fall) = (solver.solve(&still), solver.solve(&fall));
        let (mut off, mut cross, mut sharp) = (0.0, 0.0, 0.0);
        for (row, b, d) in &rows {
            let (rc, rg) = (row.dot(&still) - b, row.dot(&fall) - d);
            off += (rc + g * rg).powi(2);
            cross += rc * rg;
            sharp += rg * rg;
        }
        let at = z.len() / 2;
        let ahead = (object.cameras[first + at].c2w.rotation * Vector3::z()) / z[at];
        let place = solver.inverse().fixed_view::<3, 3>(0, 0).into_owned();
        Some(Self {
            middle,
            still,
            fall,
            miss_px: (2.0 * off / rows.len() as f64).sqrt(),
            seen: rows.len() / 2,
            doubt: ahead.dot(&(place * ahead)).sqrt(),
            best: -cross / sharp.max(1e-30),
            sharp,
        })
    }

    /// The middle of the object in frame `k` at the acceleration `g`.
    pub fn at(&self, k: usize, ground: &Ground, g: f64) -> Vector3<f64> {
        let t = k as f64 - self.middle;
        let x = self.still + self.fall * g;
        x.fixed_rows::<3>(0) + x.fixed_rows::<3>(3) * t + ground.down * (0.5 * g * t * t)
    }

    /// Its z-depth in the camera of that frame.
    pub fn depth(&self, camera: &Camera, k: usize, ground: &Ground, g: f64) -> f64 {
        camera.w2c().transform(&self.at(k, ground, g)).z
    }
}
