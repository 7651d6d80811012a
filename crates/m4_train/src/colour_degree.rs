//! The degrees of the harmonics of colours, and how they rise during a run (Minute4D Eq. 2,
//! docs/spec/optimiser.md 1.8).
//!
//! A run starts with constant colours. Coefficients are added when their turn comes: steps before
//! cost what they cost without any, and a scene always says which degrees it has.

use m4_core::{Column, SplatLayout, Splats};
use m4_kernels::adam::cpu::AdamState;
use serde::{Deserialize, Serialize};

/// Highest degrees of the harmonics of colours. The default is 0 for both: one colour per splat.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColourDegree {
    /// Of the harmonics of direction, 0..=3.
    pub space: usize,
    /// Of the harmonics of time, 0..=2. Static splats have no time: theirs stay 0.
    pub time: usize,
}

/// Shares of the run after which degrees 1, 2 and 3 are added. 3DGS raises the degree every 1000
/// iterations: these shares of the paper's 5000.
const RISES: [f32; 3] = [0.2, 0.4, 0.6];

impl ColourDegree {
    /// The degrees at `x` of the run (0..1).
    pub(crate) fn at(self, x: f32) -> Self {
        let risen = RISES.iter().filter(|&&rise| x >= rise).count();
        Self {
            space: self.space.min(risen),
            time: self.time.min(risen),
        }
    }

    /// `layout` with these degrees, or with its own where they are higher.
    #[must_use]
    pub(crate) fn raise(self, layout: SplatLayout) -> SplatLayout {
        SplatLayout {
            sh_degree: self.space.max(layout.sh_degree),
            time_degree: self.time.max(layout.time_degree),
            ..layout
        }
    }

    /// The mean over the run of the colour coefficients that splats of `layout` have in addition,
    /// as a share of those at its end; 0 if there are none.
    pub(crate) fn mean_share(self, layout: SplatLayout) -> f64 {
        let added = |x| (self.at(x).raise(layout).colour_terms() - layout.colour_terms()) as f64;
        let ends = RISES.iter().skip(1).chain(&[1.0]);
        let sum: f64 = RISES
            .iter()
            .zip(ends)
            .map(|(&from, &to)| f64::from(to - from) * added(from))
            .sum();
        if sum > 0.0 { sum / added(1.0) } else { 0.0 }
    }
}

/// Adds the colour coefficients that `layout` has and `splats` lack: 0, without moments.
pub(crate) fn add_coefficients(splats: &mut Splats, adam: &mut AdamState, layout: SplatLayout) {
    for columns in [splats, &mut adam.m, &mut adam.v] {
        columns.raise_degrees(layout.sh_degree, layout.time_degree);
    }
}

/// Moves the harmonics of time of dynamic splat `i` with its middle, by `dt` frames:
/// `K_n -> K_n cos(2 pi n dt / period)`. At its new middle the splat has the colour that it had
/// there (docs/spec/optimiser.md 1.8).
pub(crate) fn move_phase(splats: &mut Splats, i: usize, dt: f32, period: f32) {
    let (layout, row) = (splats.layout(), splats.n_static() + i);
    for n in 1..=layout.time_degree {
        let factor = (std::f32::consts::TAU * n as f32 * dt / period).cos();
        let first = 3 * n * layout.sh_terms();
        for k in first..first + 3 * layout.sh_terms() {
            splats.column_mut(Column::Colour, k)[row] *= factor;
        }
    }
}

/// [`move_phase`] of dynamic splats that were row `rows[row]` when the middles were `before` and
/// `n_static` rows were static.
pub(crate) fn move_phases(
    splats: &mut Splats,
    before: &[f32],
    n_static: usize,
    rows: &[u32],
    period: f32,
) {
    for i in 0..splats.n_dynamic() {
        let parent = rows[splats.n_static() + i] as usize - n_static;
        let dt = splats.column(Column::TimeMean, 0)[i] - before[parent];
        if dt != 0.0 {
            move_phase(splats, i, dt, period);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{ColourDegree, move_phase};
    use m4_core::{Column, SplatLayout, Splats};

    #[test]
    fn degrees_rise_by_share_of_the_run() {
        let of = |space, time| ColourDegree { space, time };
        let full = of(3, 2);
        let all = [0.0, 0.19, 0.2, 0.4, 0.59, 0.6, 1.0].map(|x| full.at(x));
        assert_eq!(
            all,
            [
                of(0, 0),
                of(0, 0),
                of(1, 1),
                of(2, 2),
                of(2, 2),
                of(3, 2),
                of(3, 2)
            ]
        );
        assert_eq!(of(1, 0).at(0.9), of(1, 0));
        assert_eq!(ColourDegree::default().at(1.0), of(0, 0));
    }

    #[test]
    fn a_degree_never_falls() {
        let layout = SplatLayout {
            isotropic: true,
            sh_degree: 2,
            time_degree: 0,
        };
        let raised = ColourDegree { space: 1, time: 1 }.raise(layout);
        assert_eq!(
            raised,
            SplatLayout {
                isotropic: true,
                sh_degree: 2,
                time_degree: 1
            }
        );
    }

    #[test]
    fn a_moved_middle_keeps_the_colour_that_was_there() {
        let layout = SplatLayout {
            isotropic: true,
            sh_degree: 1,
            time_degree: 2,
        };
        let mut splats = Splats::zeros(layout, 1, 2);
        let waves = |n: usize, dt: f32| (std::f32::consts::TAU * n as f32 * dt / 20.0).cos();
        let coefficients = [0.4f32, 0.7, -0.2];
        for (n, &k) in coefficients.iter().enumerate() {
            // blue of the last spatial term
            splats
                .column_mut(Column::Colour, 3 * (4 * n + 3) + 2)
                .fill(k);
        }
        move_phase(&mut splats, 1, 3.0, 20.0);
        let sum = |row: usize| -> f32 {
            (0..3)
                .map(|n| splats.column(Column::Colour, 3 * (4 * n + 3) + 2)[row])
                .sum()
        };
        let colour: f32 = coefficients
            .iter()
            .enumerate()
            .map(|(n, k)| k * waves(n, 3.0))
            .sum();
        assert!((sum(2) - colour).abs() < 1e-6, "{} for {colour}", sum(2));
        assert_eq!(
            [sum(0), sum(1)],
            [coefficients.iter().sum::<f32>(); 2],
            "the others stay"
        );
    }

    #[test]
    fn the_mean_share_weights_each_degree_by_how_long_it_is_trained() {
        let layout = SplatLayout {
            isotropic: true,
            sh_degree: 0,
            time_degree: 0,
        };
        let share = |space, time| ColourDegree { space, time }.mean_share(layout);
        assert_eq!(share(0, 0), 0.0);
        assert!((share(1, 0) - 0.8).abs() < 1e-6);
        // 3, 8 and 15 coefficients more
        assert!((share(3, 0) - (0.2 * 3.0 + 0.2 * 8.0 + 0.4 * 15.0) / 15.0).abs() < 1e-6);
    }
}
