//! Settings of the tracker; the defaults are those of docs/spec/front-end.md 1.5. Values that no caller changes are constants of
//! the files that use them.

use crate::dba::{MIN_DEPTH, Robust};

/// How a clip is tracked. Lengths are pixels of the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackerSettings {
    /// Motion beyond which a frame is taken for a keyframe: 2.
    pub motion_filter_px: f64,
    /// Distance below which the last keyframe but one is dropped: 2.
    pub keyframe_px: f64,
    /// Updates of each of the three initial phases: 10.
    pub initial_updates: usize,
    /// Updates of each new keyframe: 8.
    pub first_updates: usize,
    /// Updates that follow when no keyframe is dropped: 4.
    pub second_updates: usize,
    /// Most active edges of the front end: 48.
    pub max_factors: usize,
    /// Most back-end edges a keyframe: 16.
    pub backend_factors: usize,
    /// Updates that measure what can be seen: 10.
    pub probe_updates: usize,
    /// Updates of all keyframes: 20.
    pub backend_updates: usize,
    /// Updates of all frames: 15.
    pub final_updates: usize,
    /// Updates of the frames between keyframes: 6.
    pub filler_updates: usize,
    /// Weight of the depth prior of the back end where there is no parallax at all: 1e-5.
    pub low_parallax_alpha: f64,
    /// Least scaled depth of a point that counts: 0.25.
    pub min_depth: f64,
    /// Extra weight of residuals in the front end and the filler: none.
    pub frontend_robust: Robust,
    /// Extra weight of residuals in the back end, whose scale also tells static pixels from moving ones: none.
    pub robust: Robust,
    /// As the program that the fixtures come from: the Python twin of the published solver
    /// ([`crate::dba::DbaOptions::python_twin`]), and edges that retire by the permutation of their ages.
    #[cfg(test)]
    pub(crate) python_twin: bool,
    /// False keeps the focal length whatever can be seen: true.
    pub optimise_focal: bool,
}

impl TrackerSettings {
    /// For correspondences that do not detect motion, such as plain optical flow: residuals are judged instead.
    /// The front end takes Cauchy's weight at half a pixel of the grid, the back end that of Geman and McClure at one,
    /// whose tail lets go of moving things altogether; `docs/geometry.md` has the comparison. Where there is no parallax the
    /// prior is that of the front end: the noise of flow looks like parallax to a weak one.
    #[must_use]
    pub fn for_flow() -> Self {
        Self {
            frontend_robust: Robust::Cauchy { scale_px: 0.5 },
            robust: Robust::GemanMcClure { scale_px: 1.0 },
            low_parallax_alpha: 0.05,
            ..Self::default()
        }
    }
}

impl Default for TrackerSettings {
    fn default() -> Self {
        Self {
            motion_filter_px: 2.0,
            keyframe_px: 2.0,
            initial_updates: 10,
            first_updates: 8,
            second_updates: 4,
            max_factors: 48,
            backend_factors: 16,
            probe_updates: 10,
            backend_updates: 20,
            final_updates: 15,
            filler_updates: 6,
            low_parallax_alpha: 1e-5,
            min_depth: MIN_DEPTH,
            frontend_robust: Robust::None,
            robust: Robust::None,
            #[cfg(test)]
            python_twin: false,
            optimise_focal: true,
        }
    }
}
