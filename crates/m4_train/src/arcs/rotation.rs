//! The angular velocity of a surface, from the velocities of its splats.

use super::{position, velocity};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use m4_core::{
    Splats,
    nalgebra::{Matrix3, Vector3},
};
use std::num::NonZero;

/// One splat in so many is used: neighbours were registered together, so more of them add no information.
const EVERY: usize = 8;
/// Splats whose common rigid motion is fitted.
const NEIGHBOURS: NonZero<usize> = NonZero::new(32).unwrap();
/// Rounds of reweighting against outliers.
const ROUNDS: usize = 4;
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
    for _ in 0..ROUNDS {
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
    use super::{Motion, angular_velocity};
    use m4_core::{CounterRng, nalgebra::Vector3};

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
