//! Splats one at a time, at one instant, and without harmonics of time.

use m4_core::{Column, SplatLayout, Splats};
use std::borrow::Cow;

/// Standard deviations in time beyond this many clips count as: for ever.
pub(crate) const FOREVER_CLIPS: f64 = 1000.0;

/// What every splat has, besides its colour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Row {
    /// World units.
    pub mean: [f32; 3],
    /// Natural logarithms of world units; three equal ones for an isotropic splat.
    pub log_scale: [f32; 3],
    /// `(w, x, y, z)` of length 1.
    pub quat: [f32; 4],
    /// Logit.
    pub opacity: f32,
}

/// What a dynamic splat has in addition.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Life {
    /// Frames.
    pub time_mean: f32,
    /// Natural logarithm of frames.
    pub log_time_sd: f32,
    /// World units per frame.
    pub velocity: [f32; 3],
}

impl Row {
    /// Row `i` of `splats`.
    pub fn of(splats: &Splats, i: usize) -> Self {
        let isotropic = splats.layout().isotropic;
        let at = |column, k| splats.column(column, k)[i];
        Self {
            mean: std::array::from_fn(|k| at(Column::Mean, k)),
            log_scale: std::array::from_fn(|k| at(Column::LogScale, if isotropic { 0 } else { k })),
            quat: if isotropic {
                [1.0, 0.0, 0.0, 0.0]
            } else {
                unit(std::array::from_fn(|k| at(Column::Quat, k)))
            },
            opacity: at(Column::Opacity, 0),
        }
    }
}

impl Life {
    /// Of row `i` of `splats`; `None` for a static one.
    pub fn of(splats: &Splats, i: usize) -> Option<Self> {
        let d = i.checked_sub(splats.n_static())?;
        Some(Self {
            time_mean: splats.column(Column::TimeMean, 0)[d],
            log_time_sd: splats.column(Column::LogTimeSd, 0)[d],
            velocity: std::array::from_fn(|k| splats.column(Column::Velocity, k)[d]),
        })
    }
}

/// The quaternion with length 1; no rotation where it has no direction.
pub(crate) fn unit(q: [f32; 4]) -> [f32; 4] {
    let norm = q
        .iter()
        .map(|&v| f64::from(v) * f64::from(v))
        .sum::<f64>()
        .sqrt();
    if norm > 0.0 && norm.is_finite() {
        q.map(|v| (f64::from(v) / norm) as f32)
    } else {
        [1.0, 0.0, 0.0, 0.0]
    }
}

/// Opacity of a logit.
pub(crate) fn sigmoid(logit: f32) -> f64 {
    1.0 / (1.0 + (-f64::from(logit)).exp())
}

/// Logit of an opacity; finite for 0 and 1 too.
pub(crate) fn logit(opacity: f64) -> f32 {
    // The renderer draws nothing below 1/255 and cannot tell 1 from 1 - 1e-6.
    let p = opacity.clamp(1e-6, 1.0 - 1e-6);
    (p / (1.0 - p)).ln() as f32
}

/// Splats from rows in any order: static ones (without a life) are put first, the order stays
/// otherwise. `colour` fills the coefficients of the splat that was row `i`, as [`Column::Colour`]
/// has them.
pub(crate) fn collect(
    sh_degree: usize,
    rows: &[(Row, Option<Life>)],
    mut colour: impl FnMut(usize, &mut [f32]),
) -> Splats {
    let layout = SplatLayout {
        isotropic: false,
        sh_degree,
        time_degree: 0,
    };
    let n_static = rows.iter().filter(|(_, life)| life.is_none()).count();
    let mut splats = Splats::zeros(layout, n_static, rows.len() - n_static);
    let mut next = [0, n_static];
    let mut coefficients = vec![0.0; 3 * layout.sh_terms()];
    for (i, (row, life)) in rows.iter().enumerate() {
        let next = &mut next[usize::from(life.is_some())];
        let at = *next;
        *next += 1;
        let mut set = |column, values: &[f32], at: usize| {
            for (k, &value) in values.iter().enumerate() {
                splats.column_mut(column, k)[at] = value;
            }
        };
        set(Column::Mean, &row.mean, at);
        set(Column::LogScale, &row.log_scale, at);
        set(Column::Quat, &row.quat, at);
        set(Column::Opacity, &[row.opacity], at);
        colour(i, &mut coefficients);
        set(Column::Colour, &coefficients, at);
        if let Some(life) = life {
            let at = at - n_static;
            set(Column::TimeMean, &[life.time_mean], at);
            set(Column::LogTimeSd, &[life.log_time_sd], at);
            set(Column::Velocity, &life.velocity, at);
        }
    }
    splats
}

/// Opacities below this are not drawn at any place (the cut-off of the renderer, 1/255).
const LEAST_OPACITY: f32 = 1.0 / 255.0;
/// Splats whose marginal in time is at most this are left out of a frame
/// (docs/spec/optimiser.md 1.3).
const LEAST_MARGINAL: f64 = 0.05;

/// The splats that time `t` (frames) sees, all of them static: means moved along their velocities,
/// opacities times the marginal in time, the harmonics of time summed up. Splats that time has
/// faded to a marginal of 0.05 or an opacity below 1/255 are left out, as they are when the scene
/// is rendered. Isotropic splats get three equal scales and no rotation. `period_frames` is that of
/// the harmonics of time (docs/spec/optimiser.md 1.8: the length of the clip).
#[must_use]
pub fn instant(splats: &Splats, t: f64, period_frames: f64) -> Splats {
    let from = splats.layout();
    let layout = SplatLayout {
        isotropic: false,
        sh_degree: from.sh_degree,
        time_degree: 0,
    };
    let n_static = splats.n_static();
    let value = |column, offset, row: usize| splats.column(column, offset)[row];
    let moments: Vec<Moment> = (0..splats.n())
        .filter_map(|row| {
            let opacity = value(Column::Opacity, 0, row);
            let Some(d) = row.checked_sub(n_static) else {
                return Some(Moment {
                    row,
                    dt: 0.0,
                    opacity,
                });
            };
            let dt = t - f64::from(value(Column::TimeMean, 0, d));
            let z = dt / f64::from(value(Column::LogTimeSd, 0, d)).exp();
            let marginal = (-0.5 * z * z).exp();
            if marginal <= LEAST_MARGINAL {
                return None;
            }
            let weight = marginal / (1.0 + (-f64::from(opacity)).exp());
            // a logit of exactly 1 would be infinite
            let weight = weight.min(1.0 - f64::from(f32::EPSILON)) as f32;
            (weight >= LEAST_OPACITY).then(|| Moment {
                row,
                dt,
                opacity: (weight / (1.0 - weight)).ln(),
            })
        })
        .collect();

    let mut out = Splats::zeros(layout, moments.len(), 0);
    let terms = from.sh_terms();
    for (i, moment) in moments.iter().enumerate() {
        let row = moment.row;
        for k in 0..3 {
            let mean = value(Column::Mean, k, row);
            let moved = match row.checked_sub(n_static) {
                Some(d) => {
                    (f64::from(mean) + f64::from(value(Column::Velocity, k, d)) * moment.dt) as f32
                }
                None => mean,
            };
            out.column_mut(Column::Mean, k)[i] = moved;
            let scale = if from.isotropic { 0 } else { k };
            out.column_mut(Column::LogScale, k)[i] = value(Column::LogScale, scale, row);
        }
        for k in 0..4 {
            let unit = if k == 0 { 1.0 } else { 0.0 };
            out.column_mut(Column::Quat, k)[i] = if from.isotropic {
                unit
            } else {
                value(Column::Quat, k, row)
            };
        }
        out.column_mut(Column::Opacity, 0)[i] = moment.opacity;
        for c in 0..3 * terms {
            let sum: f64 = (0..=from.time_degree)
                .map(|n| {
                    let wave = (std::f64::consts::TAU * n as f64 * moment.dt / period_frames).cos();
                    wave * f64::from(value(Column::Colour, 3 * terms * n + c, row))
                })
                .sum();
            out.column_mut(Column::Colour, c)[i] = sum as f32;
        }
    }
    out
}

/// A splat that is seen.
struct Moment {
    row: usize,
    /// Frames since the middle of its life; 0 for a static splat.
    dt: f64,
    /// Logit.
    opacity: f32,
}

/// The splats without harmonics of time: every colour is that in the middle of the splat's life,
/// where each cosine is 1 (docs/spec/optimiser.md 1.8). Static splats lose nothing by that.
#[must_use]
pub fn at_peak(splats: &Splats) -> Cow<'_, Splats> {
    let from = splats.layout();
    if from.time_degree == 0 {
        return Cow::Borrowed(splats);
    }
    let layout = SplatLayout {
        time_degree: 0,
        ..from
    };
    let mut out = Splats::zeros(layout, splats.n_static(), splats.n_dynamic());
    for column in [
        Column::Mean,
        Column::LogScale,
        Column::Quat,
        Column::Opacity,
        Column::TimeMean,
        Column::LogTimeSd,
        Column::Velocity,
    ] {
        for k in 0..layout.range(column).len() {
            out.column_mut(column, k)
                .copy_from_slice(splats.column(column, k));
        }
    }
    let spatial = 3 * from.sh_terms();
    for c in 0..spatial {
        let sum = out.column_mut(Column::Colour, c);
        for n in 0..=from.time_degree {
            for (sum, &term) in sum
                .iter_mut()
                .zip(splats.column(Column::Colour, spatial * n + c))
            {
                *sum += term;
            }
        }
    }
    Cow::Owned(out)
}

/// Signs of real spherical harmonics when y and z change theirs: -1 for an odd number of factors y
/// and z.
const HARMONICS: [f32; 16] = [
    1.0, // 1
    -1.0, -1.0, 1.0, // y, z, x
    -1.0, 1.0, 1.0, -1.0, 1.0, // xy, yz, 2zz-xx-yy, xz, xx-yy
    -1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0, // y(..), xyz, y(..), z(..), x(..), z(..), x(..)
];

/// Turns splats; twice is the identity, bit for bit.
pub(crate) fn turn_splats(splats: &mut Splats) {
    let layout = splats.layout();
    for column in [Column::Mean, Column::Velocity] {
        for k in 1..3 {
            negate(splats.column_mut(column, k));
        }
    }
    // F R F: the axes of the Gaussian may point either way
    for k in 2..layout.range(Column::Quat).len() {
        negate(splats.column_mut(Column::Quat, k));
    }
    for term in 0..layout.colour_terms() {
        if HARMONICS[term % layout.sh_terms()] < 0.0 {
            for channel in 0..3 {
                negate(splats.column_mut(Column::Colour, 3 * term + channel));
            }
        }
    }
}

fn negate(column: &mut [f32]) {
    for v in column {
        *v = -*v;
    }
}

#[cfg(test)]
mod tests {
    use super::{HARMONICS, at_peak, instant, turn_splats};
    use m4_core::nalgebra::{Vector3, Vector4};
    use m4_core::{Column, SplatLayout, Splats, quat};

    #[test]
    fn instants_evaluate_motion_and_temporal_weight() {
        let layout = SplatLayout {
            isotropic: true,
            sh_degree: 0,
            time_degree: 1,
        };
        let mut splats = Splats::zeros(layout, 1, 2);
        splats
            .column_mut(Column::TimeMean, 0)
            .copy_from_slice(&[10.0, 90.0]);
        splats
            .column_mut(Column::LogTimeSd, 0)
            .copy_from_slice(&[2f32.ln(), 0.0]);
        splats
            .column_mut(Column::Velocity, 1)
            .copy_from_slice(&[0.5, 0.0]);
        splats
            .column_mut(Column::LogScale, 0)
            .copy_from_slice(&[-1.0, -2.0, -3.0]);
        splats
            .column_mut(Column::Colour, 0)
            .copy_from_slice(&[0.1, 0.2, 0.3]);
        splats
            .column_mut(Column::Colour, 3)
            .copy_from_slice(&[0.0, 1.0, 0.0]);
        let actual = instant(&splats, 12.0, 8.0);
        assert_eq!(
            (actual.n_static(), actual.n_dynamic()),
            (2, 0),
            "the third is long before its life"
        );
        assert_eq!(actual.column(Column::Mean, 1), &[0.0, 1.0]);
        assert_eq!(actual.column(Column::LogScale, 2), &[-1.0, -2.0]);
        assert_eq!(actual.column(Column::Quat, 0), &[1.0, 1.0]);
        let opacity = 1.0 / (1.0 + (-actual.column(Column::Opacity, 0)[1]).exp());
        assert!((opacity - 0.5 * (-0.5f32).exp()).abs() < 1e-6);
        // a quarter of the period after the middle: the cosine is 0
        assert!((actual.column(Column::Colour, 0)[1] - 0.2).abs() < 1e-6);
    }

    #[test]
    fn harmonics_of_time_are_summed_up() {
        let layout = SplatLayout {
            isotropic: true,
            sh_degree: 1,
            time_degree: 2,
        };
        let mut splats = Splats::zeros(layout, 1, 1);
        // red of the second spatial term
        for (n, value) in [0.5, 0.25, 2.0].into_iter().enumerate() {
            splats.column_mut(Column::Colour, 12 * n + 3)[1] = value;
        }
        splats.column_mut(Column::Velocity, 2)[0] = 7.0;
        let peak = at_peak(&splats);
        assert_eq!(peak.layout().time_degree, 0);
        assert_eq!(peak.column(Column::Colour, 3), &[0.0, 2.75]);
        assert_eq!(peak.column(Column::Velocity, 2), &[7.0]);
    }

    #[test]
    fn rotating_splats_rotates_covariance() {
        let layout = SplatLayout {
            isotropic: false,
            sh_degree: 3,
            time_degree: 0,
        };
        let mut splats = Splats::zeros(layout, 1, 0);
        for (k, v) in [0.9, -0.3, 0.2, 0.4].into_iter().enumerate() {
            splats.column_mut(Column::Quat, k)[0] = v;
        }
        splats.column_mut(Column::Mean, 1)[0] = 2.0;
        let covariance = |s: &Splats| {
            let q = Vector4::from_fn(|k, _| f64::from(s.column(Column::Quat, k)[0])).normalize();
            let r = quat::rotation(&q);
            r * m4_core::nalgebra::Matrix3::from_diagonal(&Vector3::new(1.0, 4.0, 9.0))
                * r.transpose()
        };
        let before = covariance(&splats);
        let mut turned = splats.clone();
        turn_splats(&mut turned);
        let f = m4_core::nalgebra::Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
        assert!((covariance(&turned) - f * before * f).amax() < 1e-6);
        assert_eq!(turned.column(Column::Mean, 1), &[-2.0]);
        turn_splats(&mut turned);
        assert_eq!(turned, splats);
    }

    #[test]
    fn harmonics_change_sign_as_their_polynomials_do() {
        let value = |x: f64, y: f64, z: f64| {
            let (xx, yy, zz) = (x * x, y * y, z * z);
            [
                1.0,
                y,
                z,
                x,
                x * y,
                y * z,
                2.0 * zz - xx - yy,
                x * z,
                xx - yy,
                y * (3.0 * xx - yy),
                x * y * z,
                y * (4.0 * zz - xx - yy),
                z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
                x * (4.0 * zz - xx - yy),
                z * (xx - yy),
                x * (xx - 3.0 * yy),
            ]
        };
        let (here, turned) = (value(0.3, 0.5, 0.7), value(0.3, -0.5, -0.7));
        for l in 0..16 {
            assert!(
                (here[l] * f64::from(HARMONICS[l]) - turned[l]).abs() < 1e-12,
                "{l}"
            );
        }
    }
}
