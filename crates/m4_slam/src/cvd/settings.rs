//! Settings of consistent video depth, with their sources.

use super::CvdError;
use serde::{Deserialize, Serialize};

/// Weights of the loss terms (section 1.7 of the front end's specification).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Weights {
    /// Ratio of reprojected and sampled disparity. MegaSaM: 1.
    pub ratio: f64,
    /// Distance of the reprojected pixel from where the flow leads, pixels. MegaSaM: 0.2.
    pub flow: f64,
    /// Variance of the log ratio of initial and current disparity. MegaSaM: 1.
    pub scale_invariant: f64,
    /// Gradients of that log ratio at four scales. MegaSaM: 2.
    pub gradient: f64,
    /// Angle between the normals of initial and current depth. MegaSaM: 4 in stage 1, 5 in stage 2.
    pub normal: f64,
    /// Squared log ratio to the initial disparity, times its confidence. Ours, of no effect unless the caller gives
    /// confidences. 10: at confidence 1 it pulls harder than a ratio error with u = 0.5 from 2.5 % on.
    pub prior: f64,
}

impl Weights {
    /// Those of the first stage.
    #[must_use]
    pub fn stage1() -> Self {
        Self {
            normal: 4.0,
            ..Self::default()
        }
    }

    fn named(&self) -> [f64; 6] {
        [
            self.ratio,
            self.flow,
            self.scale_invariant,
            self.gradient,
            self.normal,
            self.prior,
        ]
    }
}

impl Default for Weights {
    /// Those of the second stage.
    fn default() -> Self {
        Self {
            ratio: 1.0,
            flow: 0.2,
            scale_invariant: 1.0,
            gradient: 2.0,
            normal: 5.0,
            prior: 10.0,
        }
    }
}

/// One run of Adam.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// Steps.
    pub steps: usize,
    /// Learning rate of every variable.
    pub learning_rate: f64,
    /// Of the loss terms.
    pub weights: Weights,
}

/// Settings of [`super::optimise()`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CvdSettings {
    /// Scale and shift of each frame, and u. MegaSaM: 100 steps, rate 1e-2, normal weight 4.
    pub stage1: Stage,
    /// The disparity of each pixel, and u. MegaSaM: 400 steps, rate 5e-3, normal weight 5.
    pub stage2: Stage,
    /// Added to the root of the second moment. 1e-8: MegaSaM (the default of Adam). Gradients are means over all
    /// pixels of all frames, about one over their number.
    pub adam_epsilon: f64,
    /// The 98th percentile of the initial disparity during the optimisation. The loss knows lengths (learning rates,
    /// depth limits, "near" = disparity above 1), and MegaSaM chose them for disparities normalised to a 98th
    /// percentile of 2. Poses and disparities are scaled on the way in and back on the way out, so results are in the
    /// caller's unit either way. `None` works in the caller's unit.
    pub working_percentile_98: Option<f64>,
}

impl Default for CvdSettings {
    fn default() -> Self {
        Self {
            stage1: Stage {
                steps: 100,
                learning_rate: 1e-2,
                weights: Weights::stage1(),
            },
            stage2: Stage {
                steps: 400,
                learning_rate: 5e-3,
                weights: Weights::default(),
            },
            adam_epsilon: 1e-8,
            working_percentile_98: Some(2.0),
        }
    }
}

impl CvdSettings {
    /// # Errors
    ///
    /// [`CvdError::Setting`] for the first setting out of range.
    pub(super) fn check(&self) -> Result<(), CvdError> {
        let fail = |name, value, range| Err(CvdError::Setting { name, value, range });
        for stage in [&self.stage1, &self.stage2] {
            if !(stage.learning_rate > 0.0 && stage.learning_rate.is_finite()) {
                return fail("learning_rate", stage.learning_rate, "above 0 and finite");
            }
            if let Some(&weight) = stage.weights.named().iter().find(|w| !(**w >= 0.0 && w.is_finite())) {
                return fail("weights", weight, "0 or more and finite");
            }
        }
        if !(self.adam_epsilon > 0.0 && self.adam_epsilon.is_finite()) {
            return fail("adam_epsilon", self.adam_epsilon, "above 0 and finite");
        }
        match self.working_percentile_98 {
            Some(p) if !(p > 0.0 && p.is_finite()) => fail("working_percentile_98", p, "above 0 and finite"),
            _ => Ok(()),
        }
    }
}
