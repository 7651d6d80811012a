//! A scene at one instant: splats without time.

use m4_core::{Column, SplatLayout, Splats};

/// Opacities below this are not drawn at any place (the cut-off of the renderer, 1/255).
const LEAST_OPACITY: f32 = 1.0 / 255.0;
/// Splats whose marginal in time is at most this are left out of a frame (docs/spec/optimiser.md 1.3).
const LEAST_MARGINAL: f64 = 0.05;

/// The splats that time `t` (frames) sees, all of them static: means moved along their velocities,
/// opacities times the marginal in time, the harmonics of time summed up. Splats that time has faded
/// to a marginal of 0.05 or an opacity below 1/255 are left out, as they are when the scene is rendered. Isotropic splats get three equal scales and no rotation.
/// `period_frames` is that of the harmonics of time (docs/spec/optimiser.md 1.8: the length of the clip).
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
                return Some(Moment { row, dt: 0.0, opacity });
            };
            let dt = t - f64::from(value(Column::TimeMean, 0, d));
            let z = dt / f64::from(value(Column::LogTimeSd, 0, d)).exp();
            let marginal = (-0.5 * z * z).exp();
            if marginal <= LEAST_MARGINAL {
                return None;
            }
            let seen = marginal / (1.0 + (-f64::from(opacity)).exp());
            // a logit of exactly 1 would be infinite
            let seen = seen.min(1.0 - f64::from(f32::EPSILON)) as f32;
            (seen >= LEAST_OPACITY).then(|| Moment {
                row,
                dt,
                opacity: (seen / (1.0 - seen)).ln(),
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
                Some(d) => (f64::from(mean) + f64::from(value(Column::Velocity, k, d)) * moment.dt) as f32,
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

#[cfg(test)]
mod tests {
    use super::instant;
    use m4_core::{Column, SplatLayout, Splats};

    #[test]
    fn instants_evaluate_motion_and_temporal_weight() {
        let layout = SplatLayout {
            isotropic: true,
            sh_degree: 0,
            time_degree: 1,
        };
        let mut splats = Splats::zeros(layout, 1, 2);
        splats.column_mut(Column::TimeMean, 0).copy_from_slice(&[10.0, 90.0]);
        splats
            .column_mut(Column::LogTimeSd, 0)
            .copy_from_slice(&[2f32.ln(), 0.0]);
        splats.column_mut(Column::Velocity, 1).copy_from_slice(&[0.5, 0.0]);
        splats
            .column_mut(Column::LogScale, 0)
            .copy_from_slice(&[-1.0, -2.0, -3.0]);
        splats.column_mut(Column::Colour, 0).copy_from_slice(&[0.1, 0.2, 0.3]);
        splats.column_mut(Column::Colour, 3).copy_from_slice(&[0.0, 1.0, 0.0]);
        let seen = instant(&splats, 12.0, 8.0);
        assert_eq!(
            (seen.n_static(), seen.n_dynamic()),
            (2, 0),
            "the third is long before its life"
        );
        assert_eq!(seen.column(Column::Mean, 1), &[0.0, 1.0]);
        assert_eq!(seen.column(Column::LogScale, 2), &[-1.0, -2.0]);
        assert_eq!(seen.column(Column::Quat, 0), &[1.0, 1.0]);
        let opacity = 1.0 / (1.0 + (-seen.column(Column::Opacity, 0)[1]).exp());
        assert!((opacity - 0.5 * (-0.5f32).exp()).abs() < 1e-6);
        // a quarter of the period after the middle: the cosine is 0
        assert!((seen.column(Column::Colour, 0)[1] - 0.2).abs() < 1e-6);
    }
}
