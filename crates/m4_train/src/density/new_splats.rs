//! The parameters of clones and children.

use super::{Origin, Plan};
use crate::{
    config::{CloneOpacity, DensityConfig, SplitPlacement},
    schedule::purpose,
};
use m4_core::{
    Column, CounterRng, ShapeError, Splats,
    nalgebra::{Vector3, Vector4},
    quat,
};
use m4_kernels::adam::cpu::AdamState;

/// Scales of drawn children, and of those of spheres, are those of the parent over this (3DGS).
const SPLIT_FACTOR: f32 = 1.6;

/// Carries a plan out: splats and optimiser state become the next ones, in place.
///
/// Clones are copies; with [`CloneOpacity::Share`] parent and clone pass together the light that
/// the parent passed. Children of a split lie as [`SplitPlacement`] says; drawn ones are taken from
/// the splat's Gaussian, in space and (dynamic splats) in time: `dt ~ N(0, w)`,
/// `x = v dt + Q diag(s) e`; their scales, that in time included, are the parent's over 1.6. The
/// draws depend on `seed`, `iteration` and the parent's row alone. Survivors keep their optimiser
/// state, new splats start from nothing. Fails with [`ShapeError`] if the plan names rows that do
/// not exist, or a static row after a dynamic one; nothing is changed then.
pub fn apply(
    config: &DensityConfig,
    plan: &Plan,
    splats: &mut Splats,
    adam: &mut AdamState,
    seed: u64,
    iteration: usize,
) -> Result<(), ShapeError> {
    apply_to_splats(config, plan, splats, seed, iteration)?;
    rearrange(adam, &plan.rows)?;
    for (row, _) in plan.is_new().iter().enumerate().filter(|&(_, &new)| new) {
        adam.forget(row);
    }
    Ok(())
}

/// [`apply`] without the optimiser's state.
fn apply_to_splats(
    config: &DensityConfig,
    plan: &Plan,
    splats: &mut Splats,
    seed: u64,
    iteration: usize,
) -> Result<(), ShapeError> {
    ShapeError::check("plan", plan.rows.len(), plan.origins.len())?;
    splats.rearrange(&plan.rows)?;
    let out = splats;
    for row in 0..out.n() {
        match plan.origins[row] {
            Origin::Kept => {}
            Origin::Cloned | Origin::Clone => {
                if config.clone_opacity == CloneOpacity::Share {
                    share_opacity(out, row);
                }
            }
            Origin::Child(k) if config.split_placement == SplitPlacement::Halves => {
                let rng =
                    CounterRng::new(seed, child_purpose(iteration, 0), u64::from(plan.rows[row]));
                halve(out, row, if k == 0 { 1.0 } else { -1.0 }, rng);
                if config.clone_opacity == CloneOpacity::Share {
                    share_opacity(out, row);
                }
            }
            Origin::Child(k) => {
                let parent = u64::from(plan.rows[row]);
                let rng = CounterRng::new(seed, child_purpose(iteration, k), parent);
                become_child(out, row, rng);
            }
        }
    }
    Ok(())
}

/// What the random numbers of child `k` of splats that are split after `iteration` steps are for;
/// the parent's row is the index.
pub(super) fn child_purpose(iteration: usize, k: u8) -> u64 {
    let key = (iteration as u64) << 8 | u64::from(k);
    purpose::SPLIT.wrapping_add(key << 32)
}

/// The state of splats that were [rearranged](Splats::rearrange) in the same way.
pub(crate) fn rearrange(adam: &mut AdamState, rows: &[u32]) -> Result<(), ShapeError> {
    adam.m.rearrange(rows)?;
    adam.v.rearrange(rows)?;
    adam.step = rows.iter().map(|&r| adam.step[r as usize]).collect();
    Ok(())
}

/// `o -> 1 - sqrt(1 - o)`.
fn share_opacity(splats: &mut Splats, row: usize) {
    let logit = &mut splats.column_mut(Column::Opacity, 0)[row];
    // 1 - o in a form that is exact for large logits
    let pass = (1.0 / (1.0 + logit.exp())).sqrt();
    let o = (1.0 - pass).clamp(1e-6, 1.0 - 1e-6);
    *logit = (o / (1.0 - o)).ln();
}

/// One half of a splat: 0.6 standard deviations along the longest axis, to the side of `sign`, 0.8
/// as long there. `0.6^2 + 0.8^2 = 1`, so that both halves together have the parent's covariance. A
/// sphere has no longest axis: a direction is drawn, the same for both, and the scale is over 1.6.
fn halve(splats: &mut Splats, row: usize, sign: f32, mut rng: CounterRng) {
    let isotropic = splats.layout().isotropic;
    let scale =
        |k: usize| splats.column(Column::LogScale, if isotropic { 0 } else { k })[row].exp();
    let axis = (1..3).fold(0, |best, k| if scale(k) > scale(best) { k } else { best });
    let shift = match isotropic {
        true => Vector3::from_fn(|_, _| rng.normal() as f32).normalize() * (sign * 0.6 * scale(0)),
        false => turned(
            splats,
            row,
            Vector3::from_fn(|k, _| {
                if k == axis {
                    sign * 0.6 * scale(k)
                } else {
                    0.0
                }
            }),
        ),
    };
    for k in 0..3 {
        splats.column_mut(Column::Mean, k)[row] += shift[k];
    }
    let (axis, factor) = if isotropic {
        (0, 1.0 / SPLIT_FACTOR)
    } else {
        (axis, 0.8)
    };
    splats.column_mut(Column::LogScale, axis)[row] += factor.ln();
}

/// A vector of the splat's own axes, in the world.
fn turned(splats: &Splats, row: usize, local: Vector3<f32>) -> Vector3<f32> {
    let q = Vector4::from_fn(|k, _| splats.column(Column::Quat, k)[row]);
    if q.norm() > 0.0 {
        quat::rotation(&q) * local
    } else {
        local
    }
}

fn become_child(splats: &mut Splats, row: usize, mut rng: CounterRng) {
    let isotropic = splats.layout().isotropic;
    let shrink = SPLIT_FACTOR.ln();
    let scale: [f32; 3] = [0, 1, 2]
        .map(|k| splats.column(Column::LogScale, if isotropic { 0 } else { k })[row].exp());
    let local = Vector3::from_fn(|k, _| scale[k] * rng.normal() as f32);
    let mut shift = if isotropic {
        local
    } else {
        turned(splats, row, local)
    };
    // a bound splat lives as its binding says
    if let Some(i) = row
        .checked_sub(splats.n_static())
        .filter(|i| *i >= splats.bindings().len())
    {
        let log_sd = &mut splats.column_mut(Column::LogTimeSd, 0)[i];
        let dt = log_sd.exp() * rng.normal() as f32;
        *log_sd -= shrink;
        splats.column_mut(Column::TimeMean, 0)[i] += dt;
        shift += Vector3::from_fn(|k, _| splats.column(Column::Velocity, k)[i] * dt);
    }
    for k in 0..3 {
        splats.column_mut(Column::Mean, k)[row] += shift[k];
    }
    for k in 0..if isotropic { 1 } else { 3 } {
        splats.column_mut(Column::LogScale, k)[row] -= shrink;
    }
}

#[cfg(test)]
mod tests {
    use super::{Origin, Plan, apply};
    use crate::config::{DensityConfig, SplitPlacement};
    use m4_core::{Binding, Column, Pose, SplatLayout, Splats, Window};
    use m4_kernels::adam::cpu::AdamState;
    use std::sync::Arc;

    fn world() -> (Splats, AdamState) {
        let layout = SplatLayout {
            isotropic: false,
            sh_degree: 0,
            time_degree: 0,
        };
        let mut splats = Splats::zeros(layout, 2, 2);
        splats.column_mut(Column::Quat, 0).fill(1.0);
        splats
            .column_mut(Column::Opacity, 0)
            .copy_from_slice(&[0.0, 1.0, 2.0, 30.0]);
        splats.column_mut(Column::Velocity, 0).fill(0.5);
        let mut adam = AdamState::new(&splats);
        adam.m.columns_mut().for_each(|c| c.fill(0.25));
        adam.v.columns_mut().for_each(|c| c.fill(0.5));
        adam.step.copy_from_slice(&[1, 2, 3, 4]);
        (splats, adam)
    }

    /// The world after [`plan`].
    fn applied(
        config: &DensityConfig,
        (splats, adam): &(Splats, AdamState),
        seed: u64,
        at: usize,
    ) -> (Splats, AdamState) {
        let (mut splats, mut adam) = (splats.clone(), adam.clone());
        apply(config, &plan(), &mut splats, &mut adam, seed, at).unwrap();
        (splats, adam)
    }

    fn plan() -> Plan {
        Plan {
            rows: vec![0, 1, 1, 2, 3, 3],
            origins: vec![
                Origin::Kept,
                Origin::Cloned,
                Origin::Clone,
                Origin::Kept,
                Origin::Child(0),
                Origin::Child(1),
            ],
            cloned: 1,
            split: 1,
            pruned: 0,
        }
    }

    #[test]
    fn survivors_keep_their_state_and_new_splats_have_none() {
        let world = world();
        let (next, state) = applied(&DensityConfig::fast(), &world, 1, 700);
        let splats = &world.0;
        assert_eq!((next.n_static(), next.n_dynamic()), (3, 3));
        assert_eq!(state.step, [1, 2, 0, 3, 0, 0]);
        let first = state.m.column(Column::Mean, 0);
        assert_eq!(first, [0.25, 0.25, 0.0, 0.25, 0.0, 0.0]);
        assert_eq!(state.v.column(Column::TimeMean, 0), [0.5, 0.0, 0.0]);
        assert!(next.is_finite());
        for k in 0..3 {
            let (old, new) = (splats.column(Column::Mean, k), next.column(Column::Mean, k));
            assert_eq!((new[0], new[1], new[3]), (old[0], old[1], old[2]));
        }
    }

    #[test]
    fn a_shared_opacity_passes_the_same_light() {
        let world = world();
        let config = DensityConfig {
            split_placement: SplitPlacement::Sample,
            ..DensityConfig::fast()
        };
        let (next, _) = applied(&config, &world, 1, 700);
        let pass = |logit: f32| 1.0 / (1.0 + logit.exp());
        let o = next.column(Column::Opacity, 0);
        assert!((pass(o[1]) * pass(o[2]) - pass(1.0)).abs() < 1e-6);
        assert_eq!(o[0], 0.0, "others keep theirs");
        assert_eq!(o[4], 30.0, "children keep their parent's");
    }

    #[test]
    fn halves_have_the_covariance_of_their_parent() {
        let mut world = world();
        let splats = &mut world.0;
        splats.column_mut(Column::LogScale, 1)[3] = 1.0;
        splats.column_mut(Column::Opacity, 0)[3] = 1.0;
        let (next, state) = applied(&DensityConfig::fast(), &world, 1, 700);
        let (y, sd) = (
            next.column(Column::Mean, 1),
            next.column(Column::LogScale, 1),
        );
        assert!((y[4] + y[5]).abs() < 1e-6 && y[4] > 0.0);
        let variance = y[4] * y[4] + (2.0 * sd[4]).exp();
        assert!((variance - 2.0f32.exp()).abs() < 1e-4, "{variance}");
        assert_eq!(
            next.column(Column::LogScale, 0)[4],
            0.0,
            "other axes keep their length"
        );
        assert_eq!(next.column(Column::TimeMean, 0)[1..], [0.0, 0.0]);
        let pass = |logit: f32| 1.0 / (1.0 + logit.exp());
        let o = next.column(Column::Opacity, 0);
        assert!((pass(o[4]) * pass(o[5]) - pass(1.0)).abs() < 1e-6);
        assert_eq!(state.step[4..], [0, 0]);
    }

    #[test]
    fn halves_of_a_sphere_lie_on_both_sides_and_live_as_long() {
        let layout = SplatLayout {
            isotropic: true,
            sh_degree: 0,
            time_degree: 0,
        };
        let splats = Splats::zeros(layout, 2, 2);
        let world = (splats.clone(), AdamState::new(&splats));
        let (next, _) = applied(&DensityConfig::faithful(), &world, 1, 700);
        let mean = |row: usize| [0, 1, 2].map(|k| next.column(Column::Mean, k)[row]);
        let (a, b) = (mean(4), mean(5));
        assert_eq!(a, b.map(|x| -x));
        assert!(
            (a.iter().map(|x| x * x).sum::<f32>() - 0.36).abs() < 1e-5,
            "{a:?}"
        );
        assert!((next.column(Column::LogScale, 0)[4] + 1.6f32.ln()).abs() < 1e-6);
        assert_eq!(
            (
                next.column(Column::TimeMean, 0)[1],
                next.column(Column::LogTimeSd, 0)[1]
            ),
            (0.0, 0.0)
        );
        let other = applied(&DensityConfig::faithful(), &world, 2, 700).0;
        assert_ne!(
            other.column(Column::Mean, 0)[4],
            a[0],
            "another seed, another direction"
        );
    }

    #[test]
    fn drawn_children_of_bound_splats_live_as_their_parent() {
        let mut world = world();
        let pose = Pose {
            position: [0.0; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
        };
        let window = Window::new(vec![0.0], vec![[0.0; 3]], vec![pose]).unwrap();
        let binding = Binding {
            window: 0,
            nodes: [0; 4],
            weights: [0.25; 4],
            life: [-1.0, 2.0],
        };
        world
            .0
            .bind(Arc::new(vec![window]), vec![binding; 2])
            .unwrap();
        let config = DensityConfig {
            split_placement: SplitPlacement::Sample,
            ..DensityConfig::fast()
        };
        let (next, _) = applied(&config, &world, 1, 700);
        assert_eq!(next.bindings(), [binding; 3]);
        assert_eq!(
            (
                next.column(Column::TimeMean, 0),
                next.column(Column::LogTimeSd, 0)
            ),
            (&[0.0; 3][..], &[0.0; 3][..])
        );
        assert_ne!(
            next.column(Column::Mean, 0)[4],
            next.column(Column::Mean, 0)[5]
        );
    }

    #[test]
    fn children_are_smaller_and_drawn_around_their_parent() {
        let world = world();
        let config = DensityConfig {
            split_placement: SplitPlacement::Sample,
            ..DensityConfig::fast()
        };
        let (mut sum, mut square, mut time) = (0.0f64, 0.0f64, 0.0f64);
        let rounds = 2000;
        for i in 0..rounds {
            let (next, _) = applied(&config, &world, 9, i);
            let (x, y) = (
                next.column(Column::Mean, 0)[4],
                next.column(Column::Mean, 1)[4],
            );
            let dt = next.column(Column::TimeMean, 0)[1];
            sum += f64::from(y);
            square += f64::from(y) * f64::from(y);
            // x = e + v dt: what is left without the drift has variance 1
            let rest = f64::from(x - 0.5 * dt);
            time += rest * rest;
            assert!((next.column(Column::LogScale, 2)[4] + 1.6f32.ln()).abs() < 1e-6);
            assert!((next.column(Column::LogTimeSd, 0)[1] + 1.6f32.ln()).abs() < 1e-6);
        }
        let n = rounds as f64;
        assert!(
            (sum / n).abs() < 0.1 && (square / n - 1.0).abs() < 0.1 && (time / n - 1.0).abs() < 0.1
        );
        let twice = |i| applied(&config, &world, 9, i).0;
        assert_eq!(twice(5), twice(5));
        assert_ne!(twice(5), twice(6));
    }
}
