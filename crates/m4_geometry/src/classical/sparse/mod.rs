//! Cameras, tracks and points from the frames of a video: corners, optical flow, epipolar geometry
//! and bundle adjustment, without weights.
//!
//! ```text
//! frames -> luma pyramids -> tracks (klt, tracking)
//!        -> does the camera move? (rotation)  -- no --> degenerate: one pose, or rotations
//!        -> does the lens zoom? (zoom, degenerate)  -- yes, and no more than that --> rotations and focal lengths
//!        -> keyframes, focal scan, start pair (two_view, five_point), growth (triangulate)
//!        -> all frames, bundle adjustment and motion classification in turn (map, bundle)
//! ```
//!
//! Where the cameras are known, [`with_cameras`] tracks, triangulates and finds dynamic points; cameras with which few tracks agree
//! are compared with those of the clip itself.
//!
//! Inside, lengths in images are *working pixels*: those of the shrunk image, measured from the
//! image centre, which is the principal point: observations by a lens that is known to differ are moved there first
//! (priors). Poses inside are world to camera.

mod adjustment;
mod bundle;
mod config;
mod degenerate;
mod five_point;
mod growth;
mod klt;
mod luma;
mod map;
mod outcome;
mod posed;
mod priors;
mod reconstruct;
mod rotation;
mod tracking;
mod triangulate;
mod two_view;
mod zoom;

#[cfg(test)]
mod tests;

pub use config::{SparseConfig, SparseError};
pub use posed::with_cameras;
pub use priors::{FocalSource, Recovered};
pub use reconstruct::{FeatureTracks, track_features};

/// Fails once the user asked to stop.
fn stopped(progress: &dyn m4_core::Progress) -> Result<(), SparseError> {
    if progress.cancelled() { Err(SparseError::Cancelled) } else { Ok(()) }
}

/// Epipolar and reprojection errors above this do not count as agreement, working pixels.
const INLIER_PX: f64 = 2.0;
