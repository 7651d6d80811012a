//! Converts colours that change with time to constant ones.

use m4_core::{Column, SplatLayout, Splats};
use std::borrow::Cow;

/// The splats without harmonics of time: every colour is that in the middle of the splat's life, where
/// each cosine is 1 (docs/spec/optimiser.md 1.8). Static splats lose nothing by that.
#[must_use]
pub fn at_peak(splats: &Splats) -> Cow<'_, Splats> {
    let from = splats.layout();
    if from.time_degree == 0 {
        return Cow::Borrowed(splats);
    }
    let layout = SplatLayout { time_degree: 0, ..from };
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
            out.column_mut(column, k).copy_from_slice(splats.column(column, k));
        }
    }
    let spatial = 3 * from.sh_terms();
    for c in 0..spatial {
        let sum = out.column_mut(Column::Colour, c);
        for n in 0..=from.time_degree {
            for (sum, &term) in sum.iter_mut().zip(splats.column(Column::Colour, spatial * n + c)) {
                *sum += term;
            }
        }
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use super::at_peak;
    use m4_core::{Column, SplatLayout, Splats};

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
}
