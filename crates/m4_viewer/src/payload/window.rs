//! How the opacity of a dynamic splat falls in time.

use m4_scene::Scene;
use serde::{Deserialize, Serialize};

/// Splats are not drawn where their temporal marginal is at most this (section 1.3).
pub(super) const MARGINAL_MIN: f64 = 0.05;
/// Where the Gaussian window falls to that, standard deviations: `sqrt(-2 ln 0.05)`.
const GAUSSIAN_REACH_SDS: f64 = 2.447_746_830_680_816;

/// The shape of the temporal marginal, one for all dynamic splats of a scene; `q = (dt / sd)^2`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TimeWindow {
    /// `exp(-q / 2)` (Eq. 1).
    #[default]
    Gaussian,
    /// With a flat top: `exp(-q^2 / 2)`.
    Flat,
}

impl TimeWindow {
    /// That of a scene.
    #[must_use]
    pub fn of(_scene: &Scene) -> Self {
        Self::Gaussian
    }

    /// What is left of the opacity so many standard deviations from the middle of the life.
    pub(super) fn marginal(self, away_sds: f64) -> f64 {
        let q = away_sds * away_sds;
        match self {
            Self::Gaussian => (-0.5 * q).exp(),
            Self::Flat => (-0.5 * q * q).exp(),
        }
    }

    /// Standard deviations in time that a splat is drawn for, to either side: where the marginal is
    /// [`MARGINAL_MIN`].
    pub(super) fn reach_sds(self) -> f64 {
        match self {
            Self::Gaussian => GAUSSIAN_REACH_SDS,
            Self::Flat => GAUSSIAN_REACH_SDS.sqrt(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{MARGINAL_MIN, TimeWindow};

    #[test]
    fn a_window_ends_at_its_reach() {
        for (window, reach) in [(TimeWindow::Gaussian, 2.4477), (TimeWindow::Flat, 1.5645)] {
            assert!((window.reach_sds() - reach).abs() < 1e-4);
            assert!((window.marginal(window.reach_sds()) - MARGINAL_MIN).abs() < 1e-12);
            assert!((window.marginal(0.0) - 1.0).abs() < 1e-12);
        }
    }
}
