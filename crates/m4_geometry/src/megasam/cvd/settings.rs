//! Settings and constants of consistent video depth, with their sources.

/// Weights of the loss terms (docs/spec/front-end.md 1.7).
#[derive(Debug, Clone, Copy, PartialEq)]
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
}

impl Weights {
    /// Weights of the first stage.
    pub const STAGE1: Self = Self {
        normal: 4.0,
        ..Self::STAGE2
    };
    /// Weights of the second stage.
    pub const STAGE2: Self = Self {
        ratio: 1.0,
        flow: 0.2,
        scale_invariant: 1.0,
        gradient: 2.0,
        normal: 5.0,
    };
}

/// Weights of both stages.
pub(super) const WEIGHTS: [Weights; 2] = [Weights::STAGE1, Weights::STAGE2];
/// Learning rate of every variable, by stage. MegaSaM: 1e-2 and 5e-3.
pub(super) const LEARNING_RATE: [f64; 2] = [1e-2, 5e-3];
/// Added to the root of the second moment. 1e-8: MegaSaM (the default of Adam). Gradients are means over all pixels of all frames,
/// about one over their number.
pub(super) const ADAM_EPSILON: f64 = 1e-8;
/// The 98th percentile of the initial disparity during the optimisation. The loss knows lengths (learning rates,
/// depth limits, "near" = disparity above 1), and MegaSaM chose them for disparities normalised to a 98th
/// percentile of 2. Poses and disparities are scaled on the way in and back on the way out, so results are in the
/// caller's unit either way.
pub(super) const WORKING_PERCENTILE_98: f64 = 2.0;

/// Settings of [`super::optimise()`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CvdSettings {
    /// Adam steps of the first stage (scale and shift of each frame, and u) and of the second (the disparity of each pixel, and u).
    /// MegaSaM: 100 and 400.
    pub steps: [usize; 2],
}

impl Default for CvdSettings {
    fn default() -> Self {
        Self { steps: [100, 400] }
    }
}
