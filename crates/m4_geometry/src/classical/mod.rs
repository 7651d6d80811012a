//! The classical front end: geometry without weights.
//!
//! ```text
//! frames -> sparse (feature tracks, structure from motion) -> dense (flow, plane sweep, motion segmentation) -> depth and masks
//! ```
//!
//! `sparse` and `dense` meet in the types of this module alone, so either can be replaced.

pub mod dense;
pub mod sparse;

use m4_core::{Camera, nalgebra::Vector3};

/// What a track shows, judged from its residuals under the static-world geometry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Motion {
    /// Consistent with a point that does not move.
    Static,
    /// Inconsistent with it.
    Dynamic,
    /// Too short or too ambiguous to tell.
    Unknown,
}

/// One image point followed through consecutive frames.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct Track {
    /// Frame of the first observation.
    pub first_frame: usize,
    /// Pixel coordinates (centre of the first pixel: 0, 0) in frames `first_frame..`, full
    /// resolution.
    pub observations: Vec<[f32; 2]>,
    /// What it shows.
    pub motion: Motion,
    /// World position, for static tracks that could be triangulated.
    pub point: Option<Vector3<f64>>,
    /// Median reprojection error of `point` over the observations, pixels; 0 without a point.
    pub residual_px: f64,
}

impl Track {
    /// The observation in `frame`, if there is one.
    #[must_use]
    pub fn at(&self, frame: usize) -> Option<[f32; 2]> {
        self.observations
            .get(frame.checked_sub(self.first_frame)?)
            .copied()
    }
}

/// How much the camera's motion reveals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CameraMotion {
    /// Enough parallax: poses, focal length and points are reconstructed.
    Parallax,
    /// The camera rotates without translating: rotations only, depth is made up.
    RotationOnly,
    /// The camera is static: one pose, depth is a placeholder.
    Static,
}

/// Cameras, tracks and points of a clip.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct SparseReconstruction {
    /// One camera per frame, sharing intrinsics; world units are arbitrary (median point depth
    /// about 1).
    pub cameras: Vec<Camera>,
    /// Every track, static and dynamic.
    pub tracks: Vec<Track>,
    /// What the motion of the camera allowed.
    pub camera_motion: CameraMotion,
    /// Median reprojection error over all static tracks, pixels.
    pub residual_px: f64,
    /// Things the user should know, with numbers.
    pub warnings: Vec<String>,
}

/// Fails unless there are as many `what` as frames of the clip.
fn check_count(what: &str, count: usize, frames: usize) -> Result<(), String> {
    let fault = || format!("there are {count} {what} for {frames} frames; give one per frame");
    if count == frames {
        Ok(())
    } else {
        Err(fault())
    }
}
