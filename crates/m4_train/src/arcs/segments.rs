//! Segments of the arcs of a rotating surface, and its angular velocity from the velocities of its splats.

use crate::arcs::{position, velocity};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use m4_core::{
    Column, Splats,
    nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3},
};
use std::num::NonZero;

/// Times of the segments' middles, in standard deviations of the splat's lifetime from its middle.
pub(super) const OFFSETS: [f32; 3] = [-STEP, 0.0, STEP];
/// Distance between the middles. 1 and 1.5 do worse (docs/decisions/0007).
const STEP: f32 = 1.2;
/// Standard deviation of the lifetime of a segment, in those of the splat.
const LIFETIME: f32 = 0.84;
/// Largest opacity: optical depths stay finite.
const MOST_OPAQUE: f32 = 0.999;
/// Least opacity of a segment: its logit stays finite.
const LEAST_OPAQUE: f32 = 1e-4;
/// Rounds of the fixed-point iteration for the two opacities; each reduces the error by about a digit.
const ROUNDS: usize = 12;

/// Opacities of the segments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shares {
    middle: f32,
    side: f32,
}

impl Shares {
    /// Returns the opacities with which the segments together are as opaque as a splat of this opacity, at the middle of each: optical
    /// depths `-ln(1 - o)` add up.
    pub fn of(opacity: f32) -> Self {
        let depth = |o: f32| -(1.0 - o.min(MOST_OPAQUE)).ln();
        let marginal = |dt: f32, sd: f32| (-0.5 * (dt / sd).powi(2)).exp();
        let (near, far) = (marginal(STEP, LIFETIME), marginal(2.0 * STEP, LIFETIME));
        let (at_middle, at_side) = (depth(opacity), depth(opacity * marginal(STEP, 1.0)));
        let solve = |depth: f32| (1.0 - (-depth.max(0.0)).exp()).clamp(LEAST_OPAQUE, MOST_OPAQUE);
        let mut out = Self { middle: opacity, side: 0.0 };
        for _ in 0..ROUNDS {
            out.side = solve(at_side - depth(near * out.middle) - depth(far * out.side));
            out.middle = solve(at_middle - 2.0 * depth(near * out.side));
        }
        out
    }
}

/// Turns row `row`, a copy of a dynamic splat with angular velocity `turn`, radians per frame, into segment `segment` of its arc.
///
/// Position and velocity are those of a rigid motion with constant angular velocity; the rotation of the splat follows it.
pub(super) fn become_segment(splats: &mut Splats, row: usize, turn: &Vector3<f32>, segment: usize, shares: &Shares) {
    let i = row - splats.n_static();
    let log_sd = splats.column(Column::LogTimeSd, 0)[i];
    let dt = OFFSETS[segment] * log_sd.exp();
    let opacity = if OFFSETS[segment] == 0.0 { shares.middle } else { shares.side };
    let rotation = UnitQuaternion::from_scaled_axis(turn * dt);
    let (p, v) = (position(splats, row), velocity(splats, i));
    let (to, onward) = (p + displacement(&v, turn, dt), rotation * v);
    for k in 0..3 {
        splats.column_mut(Column::Mean, k)[row] = to[k];
        splats.column_mut(Column::Velocity, k)[i] = onward[k];
    }
    if !splats.layout().isotropic {
        let [w, x, y, z] = [0, 1, 2, 3].map(|k| splats.column(Column::Quat, k)[row]);
        let turned = rotation.quaternion() * Quaternion::new(w, x, y, z);
        for (k, value) in [turned.w, turned.i, turned.j, turned.k].into_iter().enumerate() {
            splats.column_mut(Column::Quat, k)[row] = value;
        }
    }
    splats.column_mut(Column::Opacity, 0)[row] = (opacity / (1.0 - opacity)).ln();
    splats.column_mut(Column::TimeMean, 0)[i] += dt;
    splats.column_mut(Column::LogTimeSd, 0)[i] = log_sd + LIFETIME.ln();
}

/// Integrates over `0..dt` a velocity that is `v` at 0 and rotates by `turn` per unit of time: the chord of the arc, which is rotated by half the
/// angle `2 x`, and `sin(x) / x` as long as the arc.
fn displacement(v: &Vector3<f32>, turn: &Vector3<f32>, dt: f32) -> Vector3<f32> {
    let half = 0.5 * dt * turn;
    let angle = half.norm();
    if angle < 1e-6 {
        return v * dt;
    }
    let axis = half / angle;
    let along = axis * axis.dot(v);
    (along + UnitQuaternion::from_scaled_axis(half) * (v - along) * (angle.sin() / angle)) * dt
}

/// One splat in so many is used: neighbours were registered together, so more of them add no information.
const EVERY: usize = 8;
/// Splats whose common rigid motion is fitted.
const NEIGHBOURS: NonZero<usize> = NonZero::new(32).unwrap();
/// Rounds of reweighting against outliers.
const REWEIGHTINGS: usize = 4;
/// A residual of this many times the median halves the weight.
const OUTLIER: f32 = 1.5;
/// Median length of a vector of three standard normal numbers.
const MEDIAN_LENGTH: f32 = 1.538;
/// Added to the inertia, as a share of its trace: points on a line do not determine the rotation about it.
const RIDGE: f32 = 1e-3;

/// Places, world units, and velocities, world units per frame.
pub(super) type Motion = (Vector3<f32>, Vector3<f32>);

/// The splats of one keyframe, by place.
pub(super) struct Neighbourhood {
    tree: ImmutableKdTree<f32, 3>,
    motion: Vec<Motion>,
}

impl Neighbourhood {
    /// Indexes the dynamic rows `keyframe`; `None` if fewer than three are used.
    pub fn of(splats: &Splats, keyframe: &[usize]) -> Option<Self> {
        let motion: Vec<Motion> = keyframe
            .iter()
            .step_by(EVERY)
            .map(|&i| (position(splats, splats.n_static() + i), velocity(splats, i)))
            .collect();
        let places: Vec<[f32; 3]> = motion.iter().map(|(p, _)| (*p).into()).collect();
        let tree = ImmutableKdTree::new_from_slice(&places).ok()?;
        (motion.len() >= 3).then_some(Self { tree, motion })
    }

    /// Returns the motion of the splats nearest to a place.
    pub fn around(&self, place: &Vector3<f32>) -> Vec<Motion> {
        let count = NEIGHBOURS.min(NonZero::new(self.motion.len()).unwrap_or(NEIGHBOURS));
        let place: [f32; 3] = (*place).into();
        let near = self.tree.query(&place).nearest_n::<SquaredEuclidean<f32>>(count).execute();
        near.into_iter().map(|n| self.motion[n.item as usize]).collect()
    }
}

/// Returns the angular velocity, radians per frame, of the rigid motion that fits `motion` best with Cauchy weights, shrunk towards 0
/// by the share that the residuals explain (James and Stein 1961): 0 where it is all noise.
pub(super) fn angular_velocity(motion: &[Motion]) -> Vector3<f32> {
    let mut weights = vec![1.0f32; motion.len()];
    let mut out = Vector3::zeros();
    for _ in 0..REWEIGHTINGS {
        let total: f32 = weights.iter().sum();
        let mean = |pick: fn(&Motion) -> Vector3<f32>| -> Vector3<f32> {
            motion.iter().zip(&weights).map(|(m, w)| pick(m) * *w).sum::<Vector3<f32>>() / total
        };
        let (centre, drift) = (mean(|m| m.0), mean(|m| m.1));
        let (mut inertia, mut momentum) = (Matrix3::zeros(), Vector3::zeros());
        for ((p, v), w) in motion.iter().zip(&weights) {
            let arm = p - centre;
            inertia += (Matrix3::identity() * arm.norm_squared() - arm * arm.transpose()) * *w;
            momentum += arm.cross(&(v - drift)) * *w;
        }
        let ridge = Matrix3::identity() * (RIDGE * inertia.trace());
        let Some(inverse) = (inertia + ridge).try_inverse() else {
            return Vector3::zeros();
        };
        let turn = inverse * momentum;
        let off: Vec<f32> = motion.iter().map(|(p, v)| (v - drift - turn.cross(&(p - centre))).norm()).collect();
        let mut sorted = off.clone();
        let middle = sorted.len() / 2;
        let median = (*sorted.select_nth_unstable_by(middle, f32::total_cmp).1).max(f32::MIN_POSITIVE);
        for (w, off) in weights.iter_mut().zip(&off) {
            *w = 1.0 / (1.0 + (off / (OUTLIER * median)).powi(2));
        }
        let noise = (median / MEDIAN_LENGTH).powi(2) * inverse.trace();
        let share = 1.0 - noise / turn.norm_squared().max(f32::MIN_POSITIVE);
        out = turn * share.max(0.0);
    }
    if out.iter().all(|v| v.is_finite()) { out } else { Vector3::zeros() }
}

#[cfg(test)]
mod tests {
    use super::{LIFETIME, Motion, OFFSETS, STEP, Shares, angular_velocity, become_segment, displacement};
    use crate::arcs::{opacity, position};
    use m4_core::{
        Column, CounterRng, SplatLayout, Splats,
        nalgebra::{UnitQuaternion, Vector3},
    };

    #[test]
    fn segments_together_are_as_opaque_as_the_splat_at_every_instant() {
        for o in [0.15f32, 0.5, 0.9, 0.97, 0.998] {
            let shares = Shares::of(o);
            let marginal = |dt: f32, sd: f32| (-0.5 * (dt / sd).powi(2)).exp();
            for tenth in -15..=15 {
                let t = 0.1 * tenth as f32;
                let passed: f32 = OFFSETS
                    .iter()
                    .map(|&at| {
                        let of = if at == 0.0 { shares.middle } else { shares.side };
                        1.0 - of * marginal(t - at, LIFETIME)
                    })
                    .product();
                let want = o * marginal(t, 1.0);
                assert!((1.0 - passed - want).abs() < 0.07, "{o} at {t}: {} {want}", 1.0 - passed);
                if tenth == 0 || tenth == 12 {
                    assert!((1.0 - passed - want).abs() < 2e-3, "{o} at {t}: {} {want}", 1.0 - passed);
                }
            }
        }
    }

    #[test]
    fn a_displacement_is_the_integral_of_the_turning_velocity() {
        let (v, turn) = (Vector3::new(0.4, -0.1, 0.3), Vector3::new(0.2, 0.5, -0.3));
        for dt in [-1.5f32, 0.0, 0.7] {
            let steps = 10_000;
            let sum: Vector3<f32> = (0..steps)
                .map(|i| UnitQuaternion::from_scaled_axis(turn * (dt * (i as f32 + 0.5) / steps as f32)) * v)
                .sum();
            let sum = sum * (dt / steps as f32);
            assert!((displacement(&v, &turn, dt) - sum).norm() < 1e-4);
        }
    }

    #[test]
    fn a_segment_lies_on_the_circle_and_is_turned_with_it() {
        let layout = SplatLayout { isotropic: false, sh_degree: 0, time_degree: 0 };
        let turn = Vector3::new(0.0, 0.0, 0.5);
        let start = Vector3::new(2.0, 0.0, 7.0);
        let mut splats = Splats::zeros(layout, 1, 1);
        splats.column_mut(Column::Quat, 0).fill(2.0);
        splats.column_mut(Column::TimeMean, 0).fill(3.0);
        for k in 0..3 {
            splats.column_mut(Column::Mean, k)[1] = start[k];
            splats.column_mut(Column::Velocity, k)[0] = turn.cross(&start)[k];
        }
        let shares = Shares::of(0.9);
        become_segment(&mut splats, 1, &turn, 2, &shares);
        let angle = 0.5 * STEP;
        let on_circle = Vector3::new(2.0 * angle.cos(), 2.0 * angle.sin(), 7.0);
        assert!((position(&splats, 1) - on_circle).norm() < 1e-5);
        assert!((splats.column(Column::TimeMean, 0)[0] - 3.0 - STEP).abs() < 1e-6);
        assert!((splats.column(Column::LogTimeSd, 0)[0] - LIFETIME.ln()).abs() < 1e-6);
        let quat = [0, 3].map(|k| splats.column(Column::Quat, k)[1]);
        assert!(
            (quat[0] - 2.0 * (0.5 * angle).cos()).abs() < 1e-5 && (quat[1] - 2.0 * (0.5 * angle).sin()).abs() < 1e-5
        );
        assert!((opacity(&splats, 1) - shares.side).abs() < 1e-6);
    }

    /// A flat patch that rotates by `turn` and drifts, with velocities that are off by `noise`.
    fn patch(turn: Vector3<f32>, noise: f32, seed: u64) -> Vec<Motion> {
        let mut rng = CounterRng::new(seed, 8, 9);
        (0..32)
            .map(|_| {
                let p = Vector3::new(rng.uniform() as f32, rng.uniform() as f32, 4.0);
                let off = Vector3::from_fn(|_, _| noise * rng.normal() as f32);
                (p, turn.cross(&p) + Vector3::new(0.5, -0.2, 0.1) + off)
            })
            .collect()
    }

    #[test]
    fn a_rotation_about_any_axis_is_found_despite_outliers() {
        for turn in [[0.0, 0.0, 0.4], [0.3, 0.0, 0.0], [0.1, -0.2, 0.3]].map(Vector3::from) {
            let mut motion = patch(turn, 0.005, 7);
            for outlier in 0..4 {
                motion[7 * outlier].1 = Vector3::new(3.0, -2.0, 1.0);
            }
            let found = angular_velocity(&motion);
            assert!((found - turn).norm() < 0.1 * turn.norm(), "{turn}{found}");
        }
    }

    #[test]
    fn noise_is_no_rotation() {
        // a fit of the same velocities without shrinkage has a mean square of 0.1^2 / 32 (1 / 0.17 + 2 / 0.083) = 0.0094
        let square: f32 =
            (0..100).map(|seed| angular_velocity(&patch(Vector3::zeros(), 0.1, seed)).norm_squared()).sum();
        assert!(square / 100.0 < 0.004, "{}", square / 100.0);
        assert!(angular_velocity(&patch(Vector3::zeros(), 0.0, 1)).norm() < 1e-6);
        let line: Vec<Motion> =
            (0..32).map(|i| (Vector3::new(i as f32, 0.0, 0.0), Vector3::new(0.1, 0.0, 0.0))).collect();
        assert!(angular_velocity(&line).norm() < 1e-6);
        let point = vec![(Vector3::zeros(), Vector3::new(0.1, 0.0, 0.0)); 5];
        assert_eq!(angular_velocity(&point), Vector3::zeros());
    }
}
