//! From frames to cameras, depth and a map of static regions.
//!
//! ```text
//! frames + sensor disparity
//!   -> Frontend   keyframes one by one, a window adjusted      (Correspondence revises the edges)
//!   -> Backend    probe of what can be seen, then all keyframes, focal length if it can be seen
//!   -> fill       frames between keyframes: interpolation, poses only
//!   -> Backend    all frames
//!   -> Tracked    poses, disparities, lens, static confidence
//! ```
//!
//! Source: docs/spec/front-end.md 1.5 and 1.6; MegaSaM (Li et al. 2025), section 3. What measures
//! correspondences is behind the trait [`Correspondence`]: a network revises its answer from where
//! the present geometry projects; optical flow would be computed once per pair. Poses inside map
//! world to camera and positions are pixels of the grid (see [`crate::dba`]); [`Tracked::c2w`] is
//! the border.

mod backend;
mod correspondence;
mod frontend;
mod keyframes;
mod track;

use crate::dba::{DbaOptions, MIN_DEPTH};
pub use backend::Backend;
pub use correspondence::{
    Correspondence, CorrespondenceError, EdgeRevision, Revision, SourceRevision, TrackerError,
};
pub use frontend::{Frontend, Submitted};
pub use keyframes::{FrameInput, Keyframes};
pub use track::{
    PUBLISHED_TIME_GUARD, Tracked, TrackerInput, fill, interpolate_pose, neighbours, track,
};

/// Share of the full motion in the distance of frames: 0.3.
const BETA: f64 = 0.3;

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
    /// As the program that the fixtures come from: the Python twin of the published solver
    /// ([`crate::dba::DbaOptions::python_twin`]), and edges that retire by the permutation of their
    /// ages.
    #[cfg(test)]
    pub(crate) python_twin: bool,
    /// False keeps the focal length whatever can be seen: true.
    pub optimise_focal: bool,
}

impl TrackerSettings {
    /// What all adjustments of poses share.
    fn adjustment(&self) -> DbaOptions {
        DbaOptions {
            min_depth: self.min_depth,
            #[cfg(test)]
            python_twin: self.python_twin,
            ..DbaOptions::default()
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
            #[cfg(test)]
            python_twin: false,
            optimise_focal: true,
        }
    }
}
