//! Reads splats one at a time.

use m4_core::{Column, SplatLayout, Splats};

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
    let norm = q.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>().sqrt();
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

/// Splats from rows in any order: static ones (without a life) are put first, the order stays otherwise.
/// `colour` fills the coefficients of the splat that was row `i`, as [`Column::Colour`] has them.
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
