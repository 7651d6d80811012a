//! Bound splats as dynamic splats on straight lines, for formats and tools that know no others.
//!
//! A life is cut into stretches of equal length `d`, and each becomes a dynamic splat: the straight
//! line that fits the path best, the rotation and the colour of the middle, a lifetime of
//! `s = 0.8 step`. `step`, at least `d`, is the longest of 1, 1/2 and 1/4 times the time between
//! keys for which the line stays within the tolerance while the piece is at least half as opaque as
//! in its middle.
//!
//! Pieces overlap. Their opacity is that with which an endless row of them is, on average, as
//! opaque as the splat. Where a life ends, their sum ends as the integral of a Gaussian does, so
//! that the pieces of the splat that takes over complete it; it does not depend on `d`, so lives of
//! any length do. Longer steps would need fewer pieces, but what disappears would linger, and the
//! sum is off by up to a sixth where steps of 1 and 1/2 meet.

use super::{bake::place, cpu::drawn};
use m4_core::{Column, SplatLayout, Splats, nalgebra::Vector3};
use rayon::prelude::*;

/// Longest step, in times between keys; each further one is half as long.
const LONGEST: f64 = 1.0;
const STEPS: usize = 3;
/// Standard deviation of a piece in time, in steps.
const LIFETIME: f64 = 0.8;
/// Most pieces of a splat.
const MOST: usize = 128;
/// Standard deviations in time at which lines are compared with the path: a piece is half as opaque
/// as in its middle at the ends.
const SAMPLES: [f64; 5] = [-1.177, -0.589, 0.0, 0.589, 1.177];
/// Dynamic splats are not drawn below this share of their opacity (docs/spec/optimiser.md 1.3).
const LEAST_MARGINAL: f64 = 0.05;
/// Standard deviations beyond the clip to which an open life goes on, so that its ends are as
/// opaque as its middle.
const BEYOND: f64 = 2.5;
/// Range of opacities, for finite logits.
const OPACITY: [f64; 2] = [1e-6, 0.999_9];
/// Halvings of the range of an opacity.
const ROUNDS: usize = 40;

/// Splats without bindings, and how far they are off.
#[derive(Debug, Clone, PartialEq)]
pub struct Pieces {
    /// Static splats, pieces, and the free dynamic splats, in the order that they had.
    pub splats: Splats,
    /// The number of pieces.
    pub count: usize,
    /// Of each bound splat that is there in the clip, in ascending order: largest distance of a
    /// piece from the path, pixels, while the piece is at least half as opaque as in its middle.
    pub errors_px: Vec<f32>,
}

/// Turns bound splats into pieces.
///
/// `clip` has the first and the last frame: what lives outside is left out. `pixel` says how large
/// a pixel is at a place, world units, at a time, frames. Lines are off by at most `tolerance_px`
/// where pieces of half the time between keys are short enough.
#[must_use]
pub fn pieces(
    splats: &Splats,
    clip: [f64; 2],
    pixel: impl Fn(&Vector3<f64>, f64) -> f64 + Sync,
    tolerance_px: f64,
) -> Pieces {
    let one = |i: usize| of_splat(splats, i, clip, &pixel, tolerance_px);
    let all: Vec<(f64, Vec<Piece>)> = (0..splats.bindings().len())
        .into_par_iter()
        .map(one)
        .collect();
    let count = all.iter().map(|(_, pieces)| pieces.len()).sum();
    let mut errors_px: Vec<f32> = all
        .iter()
        .filter(|(_, pieces)| !pieces.is_empty())
        .map(|(error, _)| *error as f32)
        .collect();
    errors_px.sort_unstable_by(f32::total_cmp);
    let (layout, bound) = (splats.layout(), splats.bound());
    let mut out = Splats::zeros(
        layout,
        bound.start,
        count + splats.n_dynamic() - bound.len(),
    );
    for (c, (to, from)) in out.columns_mut().zip(splats.columns()).enumerate() {
        let (first, free) = if c < layout.shared_columns() {
            (bound.start, bound.end)
        } else {
            (0, bound.len())
        };
        to[..first].copy_from_slice(&from[..first]);
        to[first + count..].copy_from_slice(&from[free..]);
    }
    let mut next = 0;
    for (i, (_, pieces)) in all.iter().enumerate() {
        for piece in pieces {
            piece.write(splats, i, &mut out, next);
            next += 1;
        }
    }
    Pieces {
        splats: out,
        count,
        errors_px,
    }
}

/// A stretch of the life of a splat.
#[derive(Debug, Clone, Copy)]
struct Piece {
    t: f64,
    sd: f64,
    mean: Vector3<f64>,
    velocity: Vector3<f64>,
    quat: [f64; 4],
    logit: f64,
    rgb: Vector3<f64>,
}

impl Piece {
    /// Writes it as dynamic row `at` of `out`; what it does not have is that of bound splat `i`.
    fn write(&self, splats: &Splats, i: usize, out: &mut Splats, at: usize) {
        let layout = splats.layout();
        let (from, row) = (splats.n_static() + i, splats.n_static() + at);
        let scales = layout.range(Column::LogScale).len();
        (0..scales).for_each(|k| {
            out.column_mut(Column::LogScale, k)[row] = splats.column(Column::LogScale, k)[from]
        });
        (0..layout.range(Column::Quat).len())
            .for_each(|k| out.column_mut(Column::Quat, k)[row] = self.quat[k] as f32);
        for c in 0..3 * layout.sh_terms() {
            let base = if c < 3 {
                self.rgb[c] as f32
            } else {
                splats.column(Column::Colour, c)[from]
            };
            out.column_mut(Column::Colour, c)[row] = base + waves(splats, layout, c, from);
        }
        for k in 0..3 {
            out.column_mut(Column::Mean, k)[row] = self.mean[k] as f32;
            out.column_mut(Column::Velocity, k)[at] = self.velocity[k] as f32;
        }
        out.column_mut(Column::Opacity, 0)[row] = self.logit as f32;
        out.column_mut(Column::TimeMean, 0)[at] = self.t as f32;
        out.column_mut(Column::LogTimeSd, 0)[at] = self.sd.ln() as f32;
    }
}

/// What temporal harmonics add to a coefficient of a bound splat, which is drawn without time.
fn waves(splats: &Splats, layout: SplatLayout, c: usize, row: usize) -> f32 {
    let spatial = 3 * layout.sh_terms();
    (1..=layout.time_degree)
        .map(|n| splats.column(Column::Colour, spatial * n + c)[row])
        .sum()
}

/// The pieces of a bound splat, and by how much they are off, pixels.
fn of_splat(
    splats: &Splats,
    i: usize,
    clip: [f64; 2],
    pixel: &impl Fn(&Vector3<f64>, f64) -> f64,
    tolerance_px: f64,
) -> (f64, Vec<Piece>) {
    let binding = &splats.bindings()[i];
    let window = &splats.windows()[binding.window as usize];
    let gap = f64::from(window.gap());
    let (life, reach) = (binding.life.map(f64::from), drawn(window).map(f64::from));
    for k in 0..STEPS {
        let step = LONGEST * gap * 0.5f64.powi(k as i32);
        let beyond = BEYOND * LIFETIME * step;
        // a window that ends outside the clip does not make what it carries fade there
        let begin = if reach[0] > clip[0] {
            life[0].max(reach[0])
        } else {
            life[0].max(clip[0] - beyond)
        };
        let end = if reach[1] < clip[1] {
            life[1].min(reach[1])
        } else {
            life[1].min(clip[1] + beyond)
        };
        if begin >= end {
            return (0.0, Vec::new());
        }
        let length = end - begin;
        let count = ((length / step).ceil() as usize).clamp(1, MOST);
        let d = length / count as f64;
        let sd = LIFETIME * step.max(d);
        let (mut off, mut out) = (0.0f64, Vec::with_capacity(count));
        let logit = shared(
            f64::from(splats.column(Column::Opacity, 0)[splats.n_static() + i]),
            sd / d,
        );
        for j in 0..count {
            let t = begin + (j as f64 + 0.5) * d;
            let (piece, error) = line(splats, i, t, sd, pixel);
            off = off.max(error);
            out.push(Piece { logit, ..piece });
        }
        if off <= tolerance_px || k + 1 == STEPS {
            return (off, out);
        }
    }
    (0.0, Vec::new())
}

/// The line that fits the path around `t` best, weighted by what is visible of the piece, and by
/// how much it is off, pixels.
fn line(
    splats: &Splats,
    i: usize,
    t: f64,
    sd: f64,
    pixel: &impl Fn(&Vector3<f64>, f64) -> f64,
) -> (Piece, f64) {
    let path = SAMPLES.map(|x| (x * sd, place(splats, i, t + x * sd)));
    let middle = &path[SAMPLES.len() / 2].1;
    let (mut total, mut mean, mut spread, mut slope) =
        (0.0, Vector3::zeros(), 0.0, Vector3::zeros());
    for (dt, at) in &path {
        let weight = (-0.5 * (dt / sd).powi(2)).exp();
        total += weight;
        mean += at.mean * weight;
        spread += weight * dt * dt;
        slope += at.mean * (weight * dt);
    }
    let (mean, velocity) = (mean / total, slope / spread);
    let off = |(dt, at): &(f64, crate::pose::reference::Carried<f64>)| {
        (at.mean - mean - velocity * *dt).norm() / pixel(&at.mean, t + dt).max(f64::MIN_POSITIVE)
    };
    let error = path.iter().map(off).fold(0.0, f64::max);
    let quat = middle.quat.into();
    (
        Piece {
            t,
            sd,
            mean,
            velocity,
            quat,
            logit: middle.logit,
            rgb: middle.rgb,
        },
        error,
    )
}

/// The logit of pieces at distances of `1 / overlap` standard deviations that together are as
/// opaque as a splat of this logit: on average of the middle of a piece and of the middle between
/// two.
fn shared(logit: f64, overlap: f64) -> f64 {
    let want = 1.0 / (1.0 + (-logit).exp());
    let marginals = |offset: f64| -> Vec<f64> {
        let reach = (3.0 * overlap).ceil() as i32 + 1;
        let all =
            (-reach..=reach).map(|j| (-0.5 * ((f64::from(j) + offset) / overlap).powi(2)).exp());
        all.filter(|&m| m > LEAST_MARGINAL).collect()
    };
    let (at, between) = (marginals(0.0), marginals(0.5));
    let covered = |o: f64, all: &[f64]| 1.0 - all.iter().map(|m| 1.0 - o * m).product::<f64>();
    let [mut low, mut high] = OPACITY;
    for _ in 0..ROUNDS {
        let middle = 0.5 * (low + high);
        let together = 0.5 * (covered(middle, &at) + covered(middle, &between));
        (low, high) = if together < want {
            (middle, high)
        } else {
            (low, middle)
        };
    }
    (low / (1.0 - low)).ln()
}

#[cfg(test)]
mod tests {
    use super::{LEAST_MARGINAL, pieces, shared};
    use crate::pose::{at, place};
    use m4_core::{Binding, Column, Pose, SplatLayout, Splats, Window, nalgebra::Vector3};
    use m4_testkit::{SceneSpec, bound_scene};
    use std::sync::Arc;

    const LAST: f64 = 24.0;

    /// Splats with these opacities and lives, carried on a circle of radius 1 by `turn` radians a
    /// frame.
    fn circling(turn: f32, splats: &[(f32, [f32; 2])]) -> Splats {
        let layout = SplatLayout {
            isotropic: false,
            sh_degree: 0,
            time_degree: 0,
        };
        let mut out = Splats::zeros(layout, 1, splats.len() + 1);
        let keys: Vec<f32> = (0..=LAST as i32).map(|k| k as f32).collect();
        let pose = |t: &f32| {
            let (sin, cos) = (0.5 * turn * t).sin_cos();
            Pose {
                position: [0.0; 3],
                rotation: [cos, 0.0, 0.0, sin],
            }
        };
        let poses = keys.iter().map(pose).collect();
        let window = Window::new(keys, vec![[0.0; 3]], poses).unwrap();
        out.column_mut(Column::Mean, 0).fill(1.0);
        out.column_mut(Column::Quat, 0).fill(1.0);
        let opacity = splats.iter().map(|s| (s.0 / (1.0 - s.0)).ln());
        out.column_mut(Column::Opacity, 0)[1..=splats.len()]
            .iter_mut()
            .zip(opacity)
            .for_each(|(to, v)| *to = v);
        out.column_mut(Column::Trend, 1).fill(0.01);
        let bind = |&(_, life): &(f32, [f32; 2])| Binding {
            window: 0,
            nodes: [0; 4],
            weights: [0.25; 4],
            life,
        };
        out.bind(Arc::new(vec![window]), splats.iter().map(bind).collect())
            .unwrap();
        out
    }

    /// Opacity of the dynamic splats together, as far as they are drawn.
    fn opacity(splats: &Splats, t: f64) -> f64 {
        let get = |column, i: usize| f64::from(splats.column(column, 0)[i]);
        let passed = |i: usize| {
            let dt = t - get(Column::TimeMean, i);
            let marginal = (-0.5 * (dt / get(Column::LogTimeSd, i).exp()).powi(2)).exp();
            let own = 1.0 / (1.0 + (-get(Column::Opacity, splats.n_static() + i)).exp());
            if marginal > LEAST_MARGINAL {
                1.0 - own * marginal
            } else {
                1.0
            }
        };
        1.0 - (0..splats.n_dynamic() - 1).map(passed).product::<f64>()
    }

    #[test]
    fn a_surface_stays_as_opaque_within_3_percent() {
        let open = [f32::NEG_INFINITY, f32::INFINITY];
        let mut worst = [0.0f64; 3];
        for o in [0.05, 0.3, 0.6, 0.9, 0.97, 0.99] {
            // one splat for the whole clip, those of long lives that take over from each other, and
            // of long and short ones
            let ends = [
                &[][..],
                &[5.5, 9.5, 17.5],
                &[5.5, 6.5, 9.5, 11.5, 12.5, 13.5],
            ];
            for (ends, worst) in ends.into_iter().zip(&mut worst) {
                let ends = [&[open[0]], ends, &[open[1]]].concat();
                let lives: Vec<(f32, [f32; 2])> =
                    ends.windows(2).map(|w| (o, [w[0], w[1]])).collect();
                let pieces = pieces(&circling(0.2, &lives), [0.0, LAST], |_, _| 0.01, 1e9);
                for tenth in 0..=10 * LAST as i32 {
                    let t = 0.1 * f64::from(tenth);
                    *worst = worst.max((opacity(&pieces.splats, t) / f64::from(o) - 1.0).abs());
                }
            }
        }
        assert!(
            worst[0] < 0.03 && worst[1] < 0.03 && worst[2] < 0.03,
            "{worst:?}"
        );
    }

    #[test]
    fn pieces_follow_the_path_within_the_tolerance() {
        let life = [2.5, 20.5];
        let mut counts = Vec::new();
        for tolerance in [50.0, 0.3, 0.08] {
            let splats = circling(0.15, &[(0.9, life)]);
            let result = pieces(&splats, [0.0, LAST], |_, _| 0.01, tolerance);
            assert!(
                f64::from(result.errors_px[0]) <= tolerance,
                "{:?}",
                result.errors_px
            );
            counts.push(result.count);
            let out = &result.splats;
            for i in 0..result.count {
                let get = |column, k| f64::from(out.column(column, k)[i]);
                let (t, sd) = (get(Column::TimeMean, 0), get(Column::LogTimeSd, 0).exp());
                for dt in [-1.0, -0.3, 0.0, 0.8, 1.17].map(|x| x * sd) {
                    let mean = |k| {
                        f64::from(out.column(Column::Mean, k)[1 + i])
                            + get(Column::Velocity, k) * dt
                    };
                    let off =
                        (Vector3::from_fn(|k, _| mean(k)) - place(&splats, 0, t + dt).mean).norm();
                    assert!(off / 0.01 <= tolerance * 1.02, "{off} of piece {i} at {dt}");
                }
                let turned = f64::from(out.column(Column::Quat, 3)[1 + i]).asin();
                assert!(
                    (turned - 0.5 * 0.15 * t).abs() < 1e-4,
                    "rotation in the middle"
                );
                assert!((f64::from(out.column(Column::Colour, 1)[1 + i]) - 0.01 * t).abs() < 1e-5);
            }
        }
        assert_eq!(counts, [18, 36, 72]);
    }

    #[test]
    fn what_is_not_bound_stays_and_lives_outside_the_clip_are_left_out() {
        let scene = bound_scene(&SceneSpec {
            n_static: 7,
            n_dynamic: 40,
            ..SceneSpec::default()
        });
        let result = pieces(&scene.splats, [0.0, 9.0], |_, _| 0.02, 0.5);
        let (out, from) = (&result.splats, &scene.splats);
        assert!(out.bindings().is_empty() && out.is_finite() && result.errors_px.len() == 20);
        assert_eq!((out.n_static(), out.n_dynamic()), (7, result.count + 20));
        let all: Vec<u32> = (0..out.n() as u32).collect();
        let rest = [&all[..7], &all[7 + result.count..]].concat();
        let rows: Vec<u32> = (0..7).chain(27..47).collect();
        assert_eq!(
            out.gather(&rest).unwrap().columns(),
            from.gather(&rows).unwrap().columns()
        );
        assert_eq!(at(from, 50.0).n_static(), 7, "windows end");
        let late = circling(0.1, &[(0.5, [30.0, 40.0])]);
        assert_eq!(pieces(&late, [0.0, LAST], |_, _| 0.01, 1.0).count, 0);
    }

    #[test]
    fn shares_of_extreme_opacities_are_finite() {
        for logit in [-1e4, -5.0, 8.0, 1e4] {
            assert!(shared(logit, 0.8).is_finite() && shared(logit, 40.0).is_finite());
        }
    }
}
