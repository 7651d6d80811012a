//! Smooths the motion of a node over time: at a keyframe where it slipped, it follows the others
//! (docs/spec/scaffold.md 4).

use crate::init::motion::rigid::Rigid;
use m4_core::nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// Order of the differences that a path keeps small.
const ORDER: usize = 4;
/// Rounds of reweighted least squares; in the first, all weigh alike.
const ROUNDS: usize = 6;
/// Residuals of this many times their deviation count half (our rule).
const OUTLIER: f64 = 2.0;
/// Standard deviation of a normal distribution whose absolute values have a median of 1.
const NORMAL: f64 = 1.4826;

/// The motion of a node at one instant, as a frame tells it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Estimate {
    /// Seconds.
    pub time: f64,
    pub motion: Rigid,
    /// Standard deviation of the place across the view, world units.
    pub across: f32,
    /// Standard deviation of the place along the view, world units.
    pub along: f32,
}

/// What is known of paths beforehand.
#[derive(Debug, Clone, Copy)]
pub(super) struct Expected {
    /// Rows are the axes of the camera, the view last.
    pub axes: Matrix3<f32>,
    /// Standard deviation of fourth differences of places that are a second apart, world units; it
    /// goes with the time to the power 3.5, as of a path whose fourth derivative is noise.
    pub snap: f64,
    /// Radius of the piece that turns with the node, world units.
    pub radius: f32,
}

/// Returns the most likely motions of a node at the times of `estimates`, which ascend: robust, so
/// that neither a slip nor a jolt spreads. Fewer than five stay as they are.
pub(super) fn smooth(estimates: &[Estimate], expected: Expected) -> Vec<Rigid> {
    smoothed(estimates, expected).unwrap_or_else(|| estimates.iter().map(|e| e.motion).collect())
}

fn smoothed(estimates: &[Estimate], expected: Expected) -> Option<Vec<Rigid>> {
    if estimates.len() <= ORDER {
        return None;
    }
    let times: Vec<f64> = estimates.iter().map(|e| e.time).collect();
    let rows = differences(&times);
    let mut places = vec![Vector3::zeros(); estimates.len()];
    for axis in 0..3 {
        let row = expected.axes.row(axis).transpose();
        let deviation = |e: &Estimate| if axis == 2 { e.along } else { e.across };
        let data = estimates
            .iter()
            .map(|e| (row.dot(&e.motion.to), deviation(e)));
        let path = path(&data.collect::<Vec<_>>(), &rows, expected.snap)?;
        places
            .iter_mut()
            .zip(path)
            .for_each(|(p, v)| *p += row * v as f32);
    }
    let mut turns: Vec<Quaternion<f32>> = Vec::with_capacity(estimates.len());
    for e in estimates {
        let q = e.motion.rotation.into_inner();
        turns.push(if turns.last().is_some_and(|before| before.dot(&q) < 0.0) {
            -q
        } else {
            q
        });
    }
    // a quaternion has half the angle
    let scale = 0.5 / expected.radius;
    for axis in 0..4 {
        let data = turns
            .iter()
            .zip(estimates)
            .map(|(q, e)| (q.coords[axis], e.across * scale));
        let path = path(
            &data.collect::<Vec<_>>(),
            &rows,
            expected.snap * f64::from(scale),
        )?;
        turns
            .iter_mut()
            .zip(path)
            .for_each(|(q, v)| q.coords[axis] = v as f32);
    }
    let motion = |((e, to), q): ((&Estimate, Vector3<f32>), Quaternion<f32>)| {
        let rotation = UnitQuaternion::try_new(q, 0.5)?;
        Some(Rigid {
            rotation,
            from: e.motion.from,
            to,
        })
    };
    estimates
        .iter()
        .zip(places)
        .zip(turns)
        .map(motion)
        .collect()
}

/// Returns the usual size of fourth differences of paths across the view, as the standard deviation
/// for times a second apart, world units: by their median, so that slips of a minority do not
/// count. `paths` are places at the ascending `times`. `None` without differences.
pub(super) fn usual_snap(
    times: &[f64],
    paths: impl Iterator<Item = Vec<Vector3<f32>>>,
    axes: &Matrix3<f32>,
) -> Option<f64> {
    let rows = differences(times);
    let mut all = Vec::new();
    for path in paths {
        for (first, weights, unit) in &rows {
            let difference: Vector3<f32> = weights
                .iter()
                .zip(&path[*first..])
                .map(|(w, p)| p * *w as f32)
                .sum();
            let across = axes * difference;
            all.extend([across.x, across.y].map(|v| v.abs() / *unit as f32));
        }
    }
    all.retain(|v| v.is_finite());
    Some(NORMAL * f64::from(m4_core::median(&mut all)?))
}

/// A difference of five values in a row: the first of them, their weights, and its deviation for a
/// snap of 1.
type Difference = (usize, [f64; ORDER + 1], f64);

/// The differences of values at these times: 24 times the divided difference, times the mean gap to
/// the fourth power.
fn differences(times: &[f64]) -> Vec<Difference> {
    let of = |(first, t): (usize, &[f64])| {
        let gap = (t[ORDER] - t[0]) / ORDER as f64;
        let weight = |i: usize| {
            let others = (0..=ORDER).filter(|&j| j != i);
            24.0 * others.map(|j| gap / (t[i] - t[j])).product::<f64>()
        };
        (first, std::array::from_fn(weight), gap.powf(3.5))
    };
    times.windows(ORDER + 1).enumerate().map(of).collect()
}

/// The most likely values of a path whose measured values, with their standard deviations, are
/// `data`. `None` if numbers are not finite.
fn path(data: &[(f32, f32)], rows: &[Difference], snap: f64) -> Option<Vec<f64>> {
    let trust = |r: f64, round: usize| {
        if round == 0 {
            1.0
        } else {
            1.0 / (1.0 + (r / OUTLIER).powi(2))
        }
    };
    let mut x: Vec<f64> = data.iter().map(|(value, _)| f64::from(*value)).collect();
    for round in 0..ROUNDS {
        let mut h = vec![[0.0; ORDER + 1]; x.len()];
        let mut b = vec![0.0; x.len()];
        for (i, &(value, deviation)) in data.iter().enumerate() {
            let (value, deviation) = (f64::from(value), f64::from(deviation));
            let weight = trust((x[i] - value) / deviation, round) / (deviation * deviation);
            h[i][0] += weight;
            b[i] += weight * value;
        }
        for (first, weights, unit) in rows {
            let deviation = unit * snap;
            let difference: f64 = weights.iter().zip(&x[*first..]).map(|(a, x)| a * x).sum();
            let weight = trust(difference / deviation, round) / (deviation * deviation);
            for i in 0..=ORDER {
                for j in i..=ORDER {
                    h[first + i][j - i] += weight * weights[i] * weights[j];
                }
            }
        }
        x = solved(h, b)?;
    }
    Some(x)
}

/// Solves a symmetric band system, `h[i][k]` in row `i` and column `i + k`. `None` unless it is
/// positive definite.
fn solved(mut h: Vec<[f64; ORDER + 1]>, mut b: Vec<f64>) -> Option<Vec<f64>> {
    let n = b.len();
    let width = |i: usize| ORDER.min(n - 1 - i);
    for i in 0..n {
        let pivot = h[i][0];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        for k in 1..=width(i) {
            let share = h[i][k] / pivot;
            for m in k..=width(i) {
                h[i + k][m - k] -= share * h[i][m];
            }
            b[i + k] -= share * b[i];
        }
    }
    for i in (0..n).rev() {
        let later: f64 = (1..=width(i)).map(|k| h[i][k] * b[i + k]).sum();
        b[i] = (b[i] - later) / h[i][0];
    }
    Some(b)
}

#[cfg(test)]
mod tests {
    use super::{Estimate, Expected, Rigid, smooth};
    use m4_core::nalgebra::{Matrix3, UnitQuaternion, Vector3};

    const EXPECTED: Expected = Expected {
        axes: Matrix3::new(0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0),
        snap: 7e4,
        radius: 10.0,
    };

    /// Estimates of a deviation of half a unit at these times.
    fn estimates(
        times: &[f64],
        place: impl Fn(f64) -> [f64; 3],
        angle: impl Fn(f64) -> f64,
    ) -> Vec<Estimate> {
        let at = |&time: &f64| {
            let to = Vector3::from(place(time)).cast();
            let rotation =
                UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.6, 0.8) * angle(time) as f32);
            Estimate {
                time,
                motion: Rigid {
                    rotation,
                    from: Vector3::zeros(),
                    to,
                },
                across: 0.5,
                along: 1.0,
            }
        };
        times.iter().map(at).collect()
    }

    /// The places of a swing of 100 units, and its angles, which pass half a turn.
    fn swing(times: &[f64]) -> Vec<Estimate> {
        estimates(
            times,
            |t| {
                [
                    100.0 * (4.0 * t).sin(),
                    30.0 * (4.0 * t).cos(),
                    200.0 + 50.0 * t,
                ]
            },
            |t| 2.5 + 3.0 * t,
        )
    }

    fn apart(a: &Rigid, b: &Rigid) -> (f32, f32) {
        ((a.to - b.to).norm(), a.rotation.angle_to(&b.rotation))
    }

    #[test]
    fn a_slip_is_mended_and_the_rest_stays() {
        // a frame is missing
        let times: Vec<f64> = (0..14)
            .filter(|&k| k != 4)
            .map(|k| f64::from(k) / 24.0)
            .collect();
        let truth = swing(&times);
        let mut slipped = truth.clone();
        slipped[7].motion.to += Vector3::new(6.0, -4.0, 9.0);
        slipped[7].motion.rotation *= UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.5, 0.0));
        for (k, (path, truth)) in smooth(&slipped, EXPECTED).iter().zip(&truth).enumerate() {
            let (off, turn) = apart(path, &truth.motion);
            let (most, most_turn) = if k == 7 { (1.5, 0.1) } else { (0.3, 0.05) };
            assert!(off < most && turn < most_turn, "keyframe {k}: {off} {turn}");
        }
    }

    #[test]
    fn a_jolt_does_not_spread() {
        let times: Vec<f64> = (0..15).map(|k| f64::from(k) / 24.0).collect();
        let bounce = estimates(
            &times,
            |t| [0.0, 300.0 * (t - 7.0 / 24.0).abs(), 200.0],
            |_| 0.0,
        );
        // of 12.5 from frame to frame
        for (k, (path, e)) in smooth(&bounce, EXPECTED).iter().zip(&bounce).enumerate() {
            let (off, _) = apart(path, &e.motion);
            assert!(k == 7 || off < 1.0, "keyframe {k}: {off}");
        }
    }

    #[test]
    fn the_usual_snap_is_that_of_most_nodes() {
        let times: Vec<f64> = (0..15).map(|k| f64::from(k) / 24.0).collect();
        // to and fro
        let path = |size: f32| {
            (0..15)
                .map(|k| Vector3::new(size * [0.0, 1.0, 1.0, 0.0][k % 4], 0.0, 0.0))
                .collect()
        };
        let of = |sizes: &[f32]| {
            super::usual_snap(&times, sizes.iter().map(|&s| path(s)), &Matrix3::identity())
        };
        assert_eq!(of(&[]), None);
        let [alike, with_slips] = [
            of(&[1.0; 9]),
            of(&[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 50.0, 50.0]),
        ]
        .map(Option::unwrap);
        assert!(with_slips <= 1.5 * alike, "{alike} {with_slips}");
        assert!(
            alike > 0.0 && (of(&[2.0; 9]).unwrap() / alike - 2.0).abs() < 1e-3,
            "{alike}"
        );
    }

    #[test]
    fn a_few_and_what_is_no_number_stay() {
        let few = swing(&[0.0, 0.1, 0.2, 0.3]);
        assert_eq!(
            smooth(&few, EXPECTED),
            few.iter().map(|e| e.motion).collect::<Vec<_>>()
        );
        let mut wrong = swing(&[0.0, 0.1, 0.2, 0.3, 0.4]);
        wrong[2].motion.to.x = f32::NAN;
        let paths = smooth(&wrong, EXPECTED);
        assert_eq!(paths[0], wrong[0].motion);
        assert!(smooth(&[], EXPECTED).is_empty());
    }
}
