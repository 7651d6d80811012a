//! Smooth interpolation of points and poses.
//!
//! Between two nodes the curve is a cubic Bezier curve whose slopes at the nodes are the
//! differences to the neighbours, weighted by the times between them: a non-uniform Catmull-Rom
//! spline. Rotations use the same construction with great arcs instead of straight lines (Shoemake,
//! "Animating rotation with quaternion curves", 1985).

use m4_core::{
    Se3,
    nalgebra::{Rotation3, SVector, UnitQuaternion, Vector3},
};

/// A curve with continuous slope through points in `N` dimensions.
#[derive(Debug, Clone)]
pub struct Spline<const N: usize> {
    times: Vec<f64>,
    points: Vec<SVector<f64, N>>,
    slopes: Vec<SVector<f64, N>>,
}

impl<const N: usize> Spline<N> {
    /// Through `points` at `times`, which increase; both of the same length, at least 1.
    pub fn new(times: Vec<f64>, points: Vec<SVector<f64, N>>) -> Self {
        let steps: Vec<_> = (1..points.len())
            .map(|i| points[i] - points[i - 1])
            .collect();
        let slopes = slopes(&times, &steps);
        Self {
            times,
            points,
            slopes,
        }
    }

    /// The point at a time; before the first node and after the last one the nearest node.
    pub fn at(&self, time: f64) -> SVector<f64, N> {
        let (i, u) = place(&self.times, time);
        if u == 0.0 {
            return self.points[i];
        }
        let third = (self.times[i + 1] - self.times[i]) / 3.0;
        let (a, d) = (self.points[i], self.points[i + 1]);
        let (b, c) = (a + self.slopes[i] * third, d - self.slopes[i + 1] * third);
        let v = 1.0 - u;
        a * (v * v * v) + b * (3.0 * v * v * u) + c * (3.0 * v * u * u) + d * (u * u * u)
    }
}

/// A camera's smooth way through poses.
#[derive(Debug, Clone)]
pub struct PoseSpline {
    centres: Spline<3>,
    poses: Vec<Se3<f64>>,
    turns: Vec<UnitQuaternion<f64>>,
    /// Turn a unit of time at each node, radians, in the axes of the node.
    spins: Vec<Vector3<f64>>,
}

impl PoseSpline {
    /// Through `poses` (camera to world) at `times`, which increase; both of the same length, at
    /// least 1.
    pub fn new(times: Vec<f64>, poses: Vec<Se3<f64>>) -> Self {
        let turns: Vec<_> = poses.iter().map(|p| quaternion(&p.rotation)).collect();
        let steps: Vec<_> = (1..turns.len())
            .map(|i| (turns[i - 1].inverse() * turns[i]).scaled_axis())
            .collect();
        let spins = slopes(&times, &steps);
        let points = poses.iter().map(|p| p.translation).collect();
        Self {
            centres: Spline::new(times, points),
            poses,
            turns,
            spins,
        }
    }

    /// The pose at a time: exactly that of a node at its time, the nearest node's outside.
    pub fn at(&self, time: f64) -> Se3<f64> {
        let times = &self.centres.times;
        let (i, u) = place(times, time);
        if u == 0.0 {
            return self.poses[i];
        }
        let third = (times[i + 1] - times[i]) / 3.0;
        let (a, d) = (self.turns[i], self.turns[i + 1]);
        let b = a * UnitQuaternion::from_scaled_axis(self.spins[i] * third);
        let c = d * UnitQuaternion::from_scaled_axis(self.spins[i + 1] * -third);
        // De Casteljau's construction.
        let (ab, bc, cd) = (arc(&a, &b, u), arc(&b, &c, u), arc(&c, &d, u));
        let turn = arc(&arc(&ab, &bc, u), &arc(&bc, &cd, u), u);
        Se3 {
            rotation: turn.to_rotation_matrix().into_inner(),
            translation: self.centres.at(time),
        }
    }
}

/// A rotation matrix as a quaternion.
pub fn quaternion(rotation: &m4_core::nalgebra::Matrix3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation))
}

/// The share `u` of the shorter great arc from `a` to `b`.
fn arc(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>, u: f64) -> UnitQuaternion<f64> {
    a * UnitQuaternion::from_scaled_axis((a.inverse() * b).scaled_axis() * u)
}

/// The node before a time, and the share of the way to the next; 0 at the last node.
fn place(times: &[f64], time: f64) -> (usize, f64) {
    let last = times.len() - 1;
    let next = times.partition_point(|t| *t <= time);
    if next == 0 {
        return (0, 0.0);
    }
    if next > last {
        return (last, 0.0);
    }
    let i = next - 1;
    (i, (time - times[i]) / (times[next] - times[i]))
}

/// Slopes at the nodes from the steps between them.
fn slopes<const N: usize>(times: &[f64], steps: &[SVector<f64, N>]) -> Vec<SVector<f64, N>> {
    let gap = |i: usize| times[i + 1] - times[i];
    let slope = |i: usize| steps[i] / gap(i);
    let n = times.len();
    (0..n)
        .map(|i| match (i.checked_sub(1), i + 1 < n) {
            (None, false) => SVector::zeros(),
            (None, true) => slope(0),
            (Some(before), false) => slope(before),
            // The shorter gap tells more.
            (Some(before), true) => {
                (slope(before) * gap(i) + slope(i) * gap(before)) / (gap(before) + gap(i))
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::{PoseSpline, Spline};
    use m4_core::{
        Se3, exp_so3, log_so3,
        nalgebra::{Matrix3, Vector1, Vector3, Vector6},
    };

    #[test]
    fn splines_reproduce_lines_and_parabolas() {
        let times = vec![0.0, 1.0, 1.5, 4.0, 5.0];
        let square = |t: f64| Vector1::new(t * t - 3.0 * t);
        let spline = Spline::new(times.clone(), times.iter().map(|t| square(*t)).collect());
        for t in [1.0, 1.2, 1.5, 2.7, 3.9] {
            assert!((spline.at(t) - square(t)).norm() < 1e-12, "{t}");
        }
        assert_eq!(
            (spline.at(-1.0), spline.at(9.0)),
            (square(0.0), square(5.0))
        );
        let one = Spline::new(vec![2.0], vec![square(2.0)]);
        assert_eq!(one.at(7.0), square(2.0));
    }

    #[test]
    fn a_steady_turn_stays_steady() {
        let axis = Vector3::new(0.2, -0.9, 0.4);
        let pose = |t: f64| Se3 {
            rotation: exp_so3(&(axis * t)),
            translation: Vector3::new(t, 2.0 * t, 1.0),
        };
        let times = vec![0.0, 0.7, 1.0, 2.2];
        let spline = PoseSpline::new(times.clone(), times.iter().map(|t| pose(*t)).collect());
        for i in 0..=44 {
            let t = f64::from(i) * 0.05;
            assert!(
                (spline.at(t).matrix() - pose(t).matrix()).norm() < 1e-9,
                "{t}"
            );
        }
    }

    #[test]
    fn nodes_are_met_exactly_and_without_corners() {
        let times = vec![0.0, 1.0, 1.4, 3.0, 3.5];
        let poses: Vec<Se3<f64>> = (0..5)
            .map(|i| {
                let k = f64::from(i);
                let twist = Vector6::new(k.sin(), k * k * 0.2, -k, 0.7 * k, (2.0 * k).cos(), 0.3);
                Se3::identity().retract(&twist)
            })
            .collect();
        let spline = PoseSpline::new(times.clone(), poses.clone());
        let h = 1e-5;
        for (t, pose) in times.iter().zip(&poses) {
            assert_eq!(spline.at(*t), *pose);
            let (a, b) = (spline.at(t - h), spline.at(t + h));
            assert!((a.matrix() - pose.matrix()).norm() < 1e-3);
            if *t > 0.0 && *t < 3.5 {
                let speed = |p: &Se3<f64>, q: &Se3<f64>| (q.translation - p.translation) / h;
                let spin = |p: &Se3<f64>, q: &Se3<f64>| {
                    log_so3(&(p.rotation.transpose() * q.rotation)) / h
                };
                assert!((speed(&a, pose) - speed(pose, &b)).norm() < 1e-3, "{t}");
                assert!((spin(&a, pose) - spin(pose, &b)).norm() < 1e-3, "{t}");
            }
        }
        let r = spline.at(2.0).rotation;
        assert!((r.transpose() * r - Matrix3::identity()).norm() < 1e-12);
    }
}
