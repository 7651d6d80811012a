//! Replaces splats of rotating surfaces by three segments of an arc (docs/spec/optimiser.md 8.8).
//!
//! A splat moves along a straight line and keeps its orientation. A rotating surface deviates from the line with the square of
//! time, so rotating objects fray between the frames. Once velocities are trained, those of neighbouring splats give the angular velocity of
//! the surface; a splat that deviates from its arc by more than half its size becomes three with shorter lifetimes, which together
//! are as opaque as it was.

mod segments;

use crate::{colour_degree::move_phase, density::rearrange};
use m4_core::{Column, ShapeError, Splats, nalgebra::Vector3};
use m4_kernels::adam::cpu::AdamState;
use rayon::prelude::*;
use segments::{Neighbourhood, OFFSETS, Shares, angular_velocity, become_segment};

/// A splat is split if, one standard deviation of its lifetime from the middle, it deviates from its arc by more than this share of its
/// size. 0.25 does no better and splits a third more, 1 gains half as much (docs/decisions/0007).
const MAX_DEVIATION: f32 = 0.5;
/// Splats below this opacity are neither split nor used to estimate angular velocities.
const MIN_OPACITY: f32 = 0.1;
/// Most splats that are split, those with the largest deviation in units of their size first: bounds the memory, some 300 bytes per new splat.
const MAX_SPLIT: usize = 300_000;

/// Replaces each of the `rotating` splats by three segments of its arc; `period` is that of the first harmonic of time, frames.
///
/// The middle segment keeps the state of the optimiser; the other two start from nothing. The other splats are unchanged, to
/// the bit, and stay in their order.
/// Fails with [`ShapeError`] if `adam` does not belong to `splats`; nothing is changed then.
pub(crate) fn split(
    splats: &mut Splats,
    adam: &mut AdamState,
    rotating: &[RotatingSplat],
    period: f32,
) -> Result<(), ShapeError> {
    ShapeError::check("optimiser state", splats.n(), adam.step.len())?;
    let n_static = splats.n_static();
    let mut rows: Vec<u32> = Vec::with_capacity(splats.n() + 2 * rotating.len());
    let mut next = rotating.iter().peekable();
    // the row, its angular velocity, and which segment it becomes
    let mut segments: Vec<(usize, Vector3<f32>, usize)> = Vec::with_capacity(3 * rotating.len());
    for row in 0..splats.n() {
        let Some(rotating) = next.next_if(|rotating| n_static + rotating.index == row) else {
            rows.push(row as u32);
            continue;
        };
        for segment in 0..OFFSETS.len() {
            segments.push((rows.len(), rotating.angular_velocity, segment));
            rows.push(row as u32);
        }
    }
    splats.rearrange(&rows)?;
    rearrange(adam, &rows)?;
    for three in segments.chunks(OFFSETS.len()) {
        let shares = Shares::of(opacity(splats, three[0].0));
        for &(row, angular_velocity, segment) in three {
            let i = row - n_static;
            let middle = splats.column(Column::TimeMean, 0)[i];
            become_segment(splats, row, &angular_velocity, segment, &shares);
            let dt = splats.column(Column::TimeMean, 0)[i] - middle;
            move_phase(splats, i, dt, period);
            if OFFSETS[segment] != 0.0 {
                adam.forget(row);
            }
        }
    }
    Ok(())
}

/// A dynamic splat that deviates from its arc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RotatingSplat {
    /// Index among the dynamic splats.
    index: usize,
    /// Of its surface, radians per frame.
    angular_velocity: Vector3<f32>,
    /// Distance between line and arc one standard deviation of its lifetime from the middle, in units of its size.
    deviation: f32,
}

/// Finds the splats to split, in order.
pub(crate) fn rotating(splats: &Splats) -> Vec<RotatingSplat> {
    let n_static = splats.n_static();
    let time = splats.column(Column::TimeMean, 0);
    let mut visible: Vec<usize> =
        (splats.bindings().len()..splats.n_dynamic()).filter(|i| opacity(splats, n_static + i) >= MIN_OPACITY).collect();
    visible.sort_by(|&a, &b| time[a].total_cmp(&time[b]).then(a.cmp(&b)));
    let mut found: Vec<RotatingSplat> = Vec::new();
    for keyframe in visible.chunk_by(|&a, &b| time[a] == time[b]) {
        let Some(neighbourhood) = Neighbourhood::of(splats, keyframe) else {
            continue;
        };
        found.par_extend(keyframe.par_iter().filter_map(|&index| {
            let angular_velocity = angular_velocity(&neighbourhood.around(&position(splats, n_static + index)));
            let deviation = deviation(splats, index, &angular_velocity);
            (deviation > MAX_DEVIATION).then_some(RotatingSplat { index, angular_velocity, deviation })
        }));
    }
    if found.len() > MAX_SPLIT {
        found.sort_by(|a, b| b.deviation.total_cmp(&a.deviation).then(a.index.cmp(&b.index)));
        found.truncate(MAX_SPLIT);
    }
    found.sort_by_key(|rotating| rotating.index);
    found
}

/// Returns the distance between line and arc of dynamic splat `i`, one standard deviation of its lifetime from the middle, in units of its size:
/// `|w x v| sd^2 / (2 size)`.
fn deviation(splats: &Splats, i: usize, angular_velocity: &Vector3<f32>) -> f32 {
    let row = splats.n_static() + i;
    let sd = splats.column(Column::LogTimeSd, 0)[i].exp();
    let axes = splats.layout().range(Column::LogScale).len();
    let log_size = (0..axes).map(|k| splats.column(Column::LogScale, k)[row]).fold(f32::MIN, f32::max);
    0.5 * angular_velocity.cross(&velocity(splats, i)).norm() * sd * sd / log_size.exp()
}

fn position(splats: &Splats, row: usize) -> Vector3<f32> {
    Vector3::from_fn(|k, _| splats.column(Column::Mean, k)[row])
}

fn velocity(splats: &Splats, i: usize) -> Vector3<f32> {
    Vector3::from_fn(|k, _| splats.column(Column::Velocity, k)[i])
}

fn opacity(splats: &Splats, row: usize) -> f32 {
    1.0 / (1.0 + (-splats.column(Column::Opacity, 0)[row]).exp())
}

#[cfg(test)]
mod tests {
    use super::{opacity, position, rotating, velocity};
    use m4_core::{Column, CounterRng, SplatLayout, Splats, nalgebra::Vector3};
    use m4_kernels::adam::cpu::AdamState;

    const RADIUS: f32 = 1.0;
    const PERIOD: f32 = 9.0;

    /// Two static splats, and a disc of radius 1 at each of two instants that moves by `velocity(place)`.
    fn discs(mut velocity: impl FnMut(Vector3<f32>) -> Vector3<f32>) -> (Splats, AdamState) {
        let layout = SplatLayout { isotropic: false, sh_degree: 0, time_degree: 0 };
        let n = 3000;
        let mut splats = Splats::zeros(layout, 2, 2 * n);
        let mut rng = CounterRng::new(1, 2, 3);
        splats.column_mut(Column::Quat, 0).fill(1.0);
        splats.column_mut(Column::Opacity, 0).fill(2.0);
        for k in 0..3 {
            splats.column_mut(Column::LogScale, k).fill(0.02f32.ln());
        }
        for i in 0..2 * n {
            let (radius, angle) = (RADIUS * rng.uniform().sqrt() as f32, std::f32::consts::TAU * rng.uniform() as f32);
            let p = Vector3::new(radius * angle.cos(), radius * angle.sin(), 5.0);
            let v = velocity(p);
            for k in 0..3 {
                splats.column_mut(Column::Mean, k)[2 + i] = p[k];
                splats.column_mut(Column::Velocity, k)[i] = v[k];
            }
            splats.column_mut(Column::TimeMean, 0)[i] = (i / n) as f32;
        }
        let mut adam = AdamState::new(&splats);
        adam.m.columns_mut().for_each(|c| c.fill(0.25));
        adam.step.fill(7);
        (splats, adam)
    }

    /// Splits the rotating splats and counts them.
    fn split(splats: &mut Splats, adam: &mut AdamState) -> usize {
        let rotating = rotating(splats);
        super::split(splats, adam, &rotating, PERIOD).unwrap();
        rotating.len()
    }

    #[test]
    fn splats_of_a_rotating_disc_become_segments_of_their_circles() {
        let turn = Vector3::new(0.0, 0.0, 0.3);
        let centre = Vector3::new(0.0, 0.0, 5.0);
        let (before, _) = discs(|p| turn.cross(&(p - centre)));
        let (mut splats, mut adam) = discs(|p| turn.cross(&(p - centre)));
        for columns in [&mut splats, &mut adam.m, &mut adam.v] {
            columns.raise_degrees(1, 1);
        }
        let harmonic = 3 * 4 + 7;
        splats.column_mut(Column::Colour, harmonic).fill(0.5);
        splats.column_mut(Column::Colour, 5).fill(0.25);
        let count = split(&mut splats, &mut adam);
        // the deviation is r 0.3^2 / 2, which is half the size from r = 0.22 on
        assert!((5300..5900).contains(&count), "{count}");
        assert_eq!((splats.n_static(), splats.n_dynamic()), (2, before.n_dynamic() + 2 * count));
        assert_eq!(adam.step.iter().filter(|&&s| s == 0).count(), 2 * count);
        assert_eq!(adam.m.n(), splats.n());
        let mut worst = 0.0f32;
        for i in 0..splats.n_dynamic() {
            let (p, v) = (position(&splats, 2 + i) - centre, velocity(&splats, i));
            // every segment moves along a circle around the centre
            worst = worst.max((v - turn.cross(&p)).norm());
        }
        assert!(worst < 0.01, "{worst}");
        // colours of direction are copied; those of time have the phase of the segment: discs are at 0 and 1, segments 1.2 frames off
        assert!(splats.column(Column::Colour, 5).iter().all(|&k| k == 0.25));
        let phases: Vec<f32> = splats.column(Column::Colour, harmonic)[2..].iter().map(|k| k / 0.5).collect();
        let side = (std::f32::consts::TAU * 1.2 / PERIOD).cos();
        assert_eq!(phases.iter().filter(|&&p| (p - side).abs() < 1e-5).count(), 2 * count);
        assert!(phases.iter().all(|p| (p - side).abs() < 1e-5 || *p == 1.0));
    }

    #[test]
    fn splats_that_do_not_rotate_are_unchanged() {
        let still = || discs(|_| Vector3::new(0.3, 0.0, 0.1));
        let (mut splats, mut adam) = still();
        assert_eq!(split(&mut splats, &mut adam), 0);
        assert_eq!((splats, adam), still());
    }

    #[test]
    fn noise_splits_few_splats() {
        let mut rng = CounterRng::new(4, 5, 6);
        let (mut splats, mut adam) = discs(|_| {
            let noise = Vector3::from_fn(|_, _| 0.02 * rng.normal() as f32);
            Vector3::new(0.3, 0.0, 0.1) + noise
        });
        let count = split(&mut splats, &mut adam);
        assert!(count < 60, "{count} of 6000");
    }

    #[test]
    fn faint_splats_and_empty_scenes_are_left_alone() {
        let turn = Vector3::new(0.0, 0.0, 0.3);
        let (mut splats, mut adam) = discs(|p| turn.cross(&p));
        splats.column_mut(Column::Opacity, 0).fill(-4.0);
        assert!(opacity(&splats, 3) < 0.02);
        assert_eq!(split(&mut splats, &mut adam), 0);
        let mut nothing = splats.gather(&[]).unwrap();
        let mut state = AdamState::new(&nothing);
        assert_eq!(split(&mut nothing, &mut state), 0);
    }
}
