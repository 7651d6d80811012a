//! Settings of the least-squares fit of colours.

use serde::{Deserialize, Serialize};

/// Colours by least squares after the last step (section 8, item 7): a picture is linear in the colours of its splats, so that they can be
/// solved for while everything else stays as it is.
///
/// A round draws frames and moves every colour by the mean of what is missing in the pixels of its splat, weighted as the
/// splat is blended there: the simultaneous iterative reconstruction technique (Gilbert 1972), whose error never grows.
/// A frame of a round costs about as much as a step, in the first round half as much again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ColourFitConfig {
    /// Rounds; 0 for no fit. 1: more of them fit what is half hidden too closely (`docs/decisions/0005`).
    pub rounds: usize,
    /// At most this many frames a round, evenly spread; 0 for all. A splat that none of them sees keeps its colour.
    pub frames: usize,
    /// What is missing is multiplied by this: above 1 it converges faster, from 2 on not at all.
    pub relax: f32,
    /// Added to the sum of a splat's weights, pixels over all frames: splats that are hardly seen hardly change.
    pub damping_px: f32,
}

impl Default for ColourFitConfig {
    fn default() -> Self {
        Self {
            rounds: 1,
            frames: 0,
            relax: 1.0,
            damping_px: 0.1,
        }
    }
}

impl ColourFitConfig {
    /// No fit.
    #[must_use]
    pub fn off() -> Self {
        Self {
            rounds: 0,
            ..Self::default()
        }
    }

    /// Frames that the fit draws, in units of what a frame of a step costs; `all` are in the capture.
    #[must_use]
    pub(crate) fn frames_drawn(&self, all: usize) -> f64 {
        if self.rounds == 0 {
            return 0.0;
        }
        let frames = if self.frames == 0 { all } else { self.frames.min(all) };
        frames as f64 * (self.rounds as f64 + 0.5)
    }
}

#[cfg(test)]
mod tests {
    use super::ColourFitConfig;

    #[test]
    fn a_fit_costs_its_rounds_and_half_a_round() {
        let mut config = ColourFitConfig {
            rounds: 2,
            ..ColourFitConfig::off()
        };
        assert_eq!(config.frames_drawn(10), 25.0);
        config.frames = 4;
        assert_eq!(config.frames_drawn(10), 10.0);
        config.rounds = 0;
        assert_eq!(config.frames_drawn(10), 0.0);
    }
}
