//! Cameras, tracks and points from the frames of a video: corners, optical flow, epipolar geometry
//! and bundle adjustment, without weights.
//!
//! ```text
//! frames -> luma pyramids -> tracks (klt, tracking), places seen again (revisits)
//!        -> does the camera move? (rotation)  -- no --> degenerate: one pose, or rotations
//!        -> does the lens zoom? (zoom, degenerate)  -- yes, and no more than that --> rotations and focal lengths
//!        -> keyframes, focal scan, start pair (two_view), growth (triangulate)
//!        -> all frames, loops closed (loops), bundle adjustment and motion classification in turn (map, bundle)
//! ```
//!
//! Where the cameras are known, [`FeatureTracks::with_cameras`] triangulates and finds dynamic
//! points; cameras with which few tracks agree are compared with those of the clip itself.
//!
//! Inside, lengths in images are *working pixels*: those of the shrunk image, measured from the
//! image centre, which is the principal point: observations by a lens that is known to differ are
//! moved there first (priors). Poses inside are world to camera.

mod anchor;
mod bundle;
mod degenerate;
mod distortion;
mod growth;
pub(crate) mod klt;
mod lens;
mod loops;
pub(crate) mod luma;
mod map;
mod outcome;
mod posed;
mod priors;
mod reconstruct;
mod revisits;
mod rival;
mod rotation;
#[cfg(test)]
mod tests;
pub(crate) mod tracking;
mod triangulate;
mod two_view;
mod zoom;

pub use distortion::RadialDistortion;
pub use priors::{FocalSource, Recovered};
pub use reconstruct::{FeatureTracks, track_features};
use serde::{Deserialize, Serialize};

/// Settings of the sparse front end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SparseConfig {
    /// Horizontal field of view, degrees, where it is known. Kept as it is.
    pub fov_deg: Option<f64>,
    /// Focal length in pixels of the input frames, where it is known. Kept as it is; takes
    /// precedence over `fov_deg`.
    pub focal_px: Option<f64>,
    /// True when the camera is known to be static: nothing is reconstructed.
    pub static_camera: bool,
    /// The lens where it is known: horizontal and vertical focal length and the principal point
    /// from the image's corner, pixels of the input frames. Kept as it is; takes precedence over
    /// `focal_px`. For callers in Rust.
    #[serde(skip)]
    pub intrinsics: Option<[f64; 4]>,
    /// True when the images are known to have no distortion: none is estimated. For callers in
    /// Rust.
    #[serde(skip)]
    pub pinhole: bool,
    /// Field of view assumed where the motion of the camera reveals nothing about it, degrees. 60:
    /// the main camera of common phones held upright to wide. For callers in Rust.
    #[serde(skip)]
    pub default_fov_deg: f64,
    /// Seed of the random samples. For callers in Rust.
    #[serde(skip)]
    pub seed: u64,
}

impl Default for SparseConfig {
    fn default() -> Self {
        Self {
            fov_deg: None,
            focal_px: None,
            static_camera: false,
            intrinsics: None,
            pinhole: false,
            default_fov_deg: 60.0,
            seed: 0,
        }
    }
}

/// Why a clip could not be reconstructed; every message says what to do next.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SparseError {
    /// Frames, masks or cameras that do not fit together; the text says which.
    #[error("{0}")]
    Input(String),
    /// A setting out of its range.
    #[error("{name} = {value} is out of range: {range}")]
    Setting {
        /// The setting at fault.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
    /// Frames that do not agree on a static scene, or given poses that contradict them; the text
    /// has the numbers.
    #[error("{0}")]
    NoAgreement(String),
    /// The user stopped the run.
    #[error("stopped by the user")]
    Cancelled,
}

/// Fails once the user asked to stop.
fn stopped(progress: &dyn m4_core::Progress) -> Result<(), SparseError> {
    if progress.cancelled() {
        Err(SparseError::Cancelled)
    } else {
        Ok(())
    }
}

/// Epipolar and reprojection errors above this do not count as agreement, working pixels.
const INLIER_PX: f64 = 2.0;
