//! The scale of a part that turns about a fixed point: a wheel, a swing, a door, a pendulum, a
//! limb with a static joint.
//!
//! With disparities times `q`, the point `s` of the part is at `c + (v + R s) / q`, `c` being the
//! camera's centre, `v` the direction from there to the middle of the part as adjusted, and `R` its
//! rotation. Only the right `q` keeps some point of the part in one place `m / q` while the camera
//! passes: `q c + v + R s = m` is linear in `q`, `s` and `m`. Multiplied by `q` in this way, the
//! error no longer favours parts close to the camera (Ozden, Schindler and Van Gool 2010).

use super::{Tracklet, WorkingClip, shape::Shape, vote::Vote};
use m4_core::quantile;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// Standard deviation of the distance between the fixed point and the middle of a part before
/// anything is measured, in sizes of the part (root mean square distance of its points from its
/// middle): of a wheel, and of a hinge or a pivot; and the largest that is believed.
const WHEEL_REACH: f64 = 0.1;
const HINGE_REACH: f64 = 6.0;
const MOST_REACH: f64 = 10.0;
/// Rounds of the robust fit, and the residual that counts half, in medians (Cauchy).
const ROUNDS: usize = 8;
const CAUCHY: f64 = 2.0;
/// Median length of a three-dimensional residual of standard deviation 1.
const MEDIAN_LENGTH: f64 = 1.54;
/// Least time within which residuals are alike, seconds.
const ALIKE_S: f64 = 1.0 / 3.0;
/// Autocorrelation at the lag that is measured, and the time within which residuals are alike over
/// that lag: exact for an exponential decay.
const HALF: f64 = 0.5;
const ALIKE_LAGS: f64 = 2.9;
/// Unknowns for each of the three equations of a measurement: factor, place, and that of the point
/// in the part.
const WHEEL_UNKNOWNS: f64 = 4.0 / 3.0;
const HINGE_UNKNOWNS: f64 = 7.0 / 3.0;
/// Least measurements beyond the unknowns.
const SPARE: f64 = 0.3;
/// Least standard deviation of a logarithm of the scale: of the shape itself.
const LEAST_SIGMA: f64 = 0.02;
/// Largest standard deviation that says anything.
const MOST_SIGMA: f64 = 0.7;

/// The scale that keeps a point of a part in place, if it turns about one; `None` where the camera
/// or the part moves too little, or too briefly.
pub(super) fn vote(clip: &WorkingClip<'_>, tracklet: &Tracklet, shape: &Shape) -> Option<Vote> {
    let (middle, size) = shape.extent(clip)?;
    let path: Vec<Pose> = (0..tracklet.parts.len())
        .map(|k| {
            let c2w = clip.cameras[tracklet.first + k].c2w;
            Pose {
                camera: c2w.translation,
                middle: c2w.rotation * shape.poses[k].transform(&middle),
                rotation: c2w.rotation * shape.poses[k].rotation,
            }
        })
        .collect();
    fixed_point(&path, size, clip.rate.exact(ALIKE_S).max(1.0))
}

/// A part and the camera in one frame.
struct Pose {
    /// Centre of the camera.
    camera: Vector3<f64>,
    /// From there to the middle of the part, in the unit of its own disparities.
    middle: Vector3<f64>,
    /// Of the part, to the world.
    rotation: Matrix3<f64>,
}

/// The vote of a path, by a wheel or a hinge: the surer one. Residuals of at least `alike`
/// neighbouring frames are taken for one measurement: those of a path that no fixed point explains
/// are alike for long, so that it says little.
fn fixed_point(path: &[Pose], size: f64, alike: f64) -> Option<Vote> {
    let votes = [(WHEEL_REACH, WHEEL_UNKNOWNS), (HINGE_REACH, HINGE_UNKNOWNS)]
        .into_iter()
        .filter_map(|(reach, unknowns)| {
            let fit = Fit::of(path, reach * size)?;
            let alike = alike.max(ALIKE_LAGS * fit.half_lag);
            let measurements = path.len() as f64 / alike;
            let spare = measurements - unknowns;
            // Fewer independent measurements than frames, and unknowns that take some of them.
            let sigma = fit.sigma * (alike * measurements / spare).sqrt() / fit.factor;
            let sure = spare >= SPARE
                && fit.factor > 0.0
                && sigma < MOST_SIGMA
                && fit.reach < MOST_REACH * size;
            sure.then(|| Vote {
                factor: fit.factor,
                sigma: sigma.max(LEAST_SIGMA),
            })
        });
    votes.min_by(|a, b| a.sigma.total_cmp(&b.sigma))
}

/// The scale that keeps a point of a part in place as well as possible.
struct Fit {
    factor: f64,
    /// Its standard deviation, if the noise of all frames were independent.
    sigma: f64,
    /// Distance of the point from the middle of the part, in the unit of the part's own
    /// disparities.
    reach: f64,
    /// Lag in frames at which the autocorrelation of residuals falls to [`HALF`].
    half_lag: f64,
}

impl Fit {
    /// A robust fit: a few frames may be wrong. `reach` is the standard deviation of the distance
    /// of the point before anything is measured.
    fn of(path: &[Pose], reach: f64) -> Option<Self> {
        let mean = path.iter().map(|p| p.camera).sum::<Vector3<f64>>() / path.len() as f64;
        let mut lengths: Vec<f64> = path.iter().map(|p| p.middle.norm()).collect();
        let distance = quantile(&mut lengths, 0.5)?;
        let (mut noise, mut weights) = (0.01 * distance, vec![1.0; path.len()]);
        let mut fit = None;
        for _ in 0..ROUNDS {
            // Unknowns: the factor, the point of the part, its place.
            let mut normal = SMatrix::<f64, 7, 7>::zeros();
            let mut right = SVector::<f64, 7>::zeros();
            for i in 1..4 {
                normal[(i, i)] = reach.powi(-2);
            }
            for (pose, weight) in path.iter().zip(&weights) {
                let rows = equations(pose, &mean);
                let weight = weight / (noise * noise);
                normal += rows.transpose() * rows * weight;
                right -= rows.transpose() * pose.middle * weight;
            }
            let covariance = normal.try_inverse()?;
            let x = covariance * right;
            let off = |pose: &Pose| equations(pose, &mean) * x + pose.middle;
            let off: Vec<Vector3<f64>> = path.iter().map(off).collect();
            let typical = quantile(&mut off.iter().map(Vector3::norm).collect::<Vec<_>>(), 0.5)?;
            noise = (typical / MEDIAN_LENGTH).max(1e-4 * distance);
            let half = (CAUCHY * typical).max(1e-12);
            let weight = |off: &Vector3<f64>| 1.0 / (1.0 + (off.norm() / half).powi(2));
            weights = off.iter().map(weight).collect();
            let weighted = off.iter().zip(&weights).map(|(off, w)| off * w.sqrt());
            fit = Some(Self {
                factor: x[0],
                sigma: covariance[(0, 0)].sqrt(),
                reach: x.fixed_rows::<3>(1).norm(),
                half_lag: half_lag(&weighted.collect::<Vec<_>>()),
            });
        }
        fit
    }
}

/// The lag in frames, between whole ones, at which the autocorrelation falls to [`HALF`].
fn half_lag(residuals: &[Vector3<f64>]) -> f64 {
    let dot = |a: &[Vector3<f64>], b: &[Vector3<f64>]| -> f64 {
        a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
    };
    let mut before = 1.0;
    for lag in 1..residuals.len() {
        let (a, b) = (&residuals[..residuals.len() - lag], &residuals[lag..]);
        let here = dot(a, b) / (dot(a, a) * dot(b, b)).sqrt().max(f64::MIN_POSITIVE);
        if here < HALF {
            return (lag - 1) as f64 + (before - HALF) / (before - here);
        }
        before = here;
    }
    residuals.len() as f64
}

/// The three equations of a frame: their product with the unknowns, plus the middle, is 0.
fn equations(pose: &Pose, mean: &Vector3<f64>) -> SMatrix<f64, 3, 7> {
    let mut rows = SMatrix::<f64, 3, 7>::zeros();
    rows.fixed_view_mut::<3, 1>(0, 0)
        .copy_from(&(pose.camera - mean));
    rows.fixed_view_mut::<3, 3>(0, 1).copy_from(&pose.rotation);
    rows.fixed_view_mut::<3, 3>(0, 4)
        .copy_from(&-Matrix3::identity());
    rows
}

#[cfg(test)]
mod tests {
    use super::{Matrix3, Pose, Vector3, fixed_point};
    use m4_core::CounterRng;
    use nalgebra::Rotation3;

    /// Frames that count as one.
    const ALIKE: f64 = 8.0;

    /// A path of 48 frames: where the camera is, the middle of the part in the world, and its
    /// rotation; disparities are to be multiplied by `factor`. The middle has a noise of 0.005.
    fn path(
        factor: f64,
        camera: impl Fn(f64) -> Vector3<f64>,
        part: impl Fn(f64) -> (Vector3<f64>, Matrix3<f64>),
    ) -> Vec<Pose> {
        let mut rng = CounterRng::new(1, 2, 3);
        (0..48)
            .map(|k| {
                let t = f64::from(k) / 24.0;
                let (middle, rotation) = part(t);
                let noise = Vector3::from_fn(|_, _| 0.005 * rng.normal());
                Pose {
                    camera: camera(t),
                    middle: (middle + noise - camera(t)) * factor,
                    rotation,
                }
            })
            .collect()
    }

    fn walk(t: f64) -> Vector3<f64> {
        Vector3::new(0.4 * t, 0.05 * (3.0 * t).sin(), 0.1 * t)
    }

    /// A bob on a rod of 0.9 that swings to and fro.
    fn pendulum(t: f64) -> (Vector3<f64>, Matrix3<f64>) {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), 0.5 * (3.3 * t).cos());
        let pivot = Vector3::new(0.3, -1.0, 3.0);
        (
            pivot + turn * Vector3::new(0.0, 0.9, 0.0),
            turn.into_inner(),
        )
    }

    #[test]
    fn a_pendulum_and_a_wheel_have_the_distance_that_fixes_their_axis() {
        let mut swing = path(1.5, walk, pendulum);
        for pose in &mut swing[10..14] {
            pose.middle += Vector3::new(0.6, 0.3, -0.8);
        }
        let vote = fixed_point(&swing, 0.15, ALIKE).unwrap();
        assert!(
            (vote.factor / 1.5 - 1.0).abs() < 2.0 * vote.sigma && vote.sigma < 0.1,
            "{vote:?}"
        );
        let wheel = |t: f64| {
            let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), 5.0 * t);
            (Vector3::new(0.5, -0.2, 4.0), turn.into_inner())
        };
        let vote = fixed_point(&path(0.8, walk, wheel), 0.3, ALIKE).unwrap();
        assert!(
            (vote.factor / 0.8 - 1.0).abs() < 2.0 * vote.sigma && vote.sigma < 0.05,
            "{vote:?}"
        );
    }

    #[test]
    fn nothing_is_said_of_a_walker_a_resting_camera_or_a_moment() {
        let walker = |t: f64| {
            let sway = Rotation3::from_axis_angle(&Vector3::y_axis(), 0.1 * (7.0 * t).sin());
            let middle = Vector3::new(1.5 * t * t - t, 0.1 * (9.0 * t).sin(), 3.0 - 0.8 * t);
            (middle, sway.into_inner())
        };
        assert_eq!(fixed_point(&path(1.0, walk, walker), 0.3, ALIKE), None);
        let rests = |_| Vector3::zeros();
        assert_eq!(fixed_point(&path(1.0, rests, pendulum), 0.15, ALIKE), None);
        let brief = &path(1.0, walk, pendulum)[..16];
        assert_eq!(fixed_point(brief, 0.15, ALIKE), None);
    }
}
