//! What callers know of the camera, and why no reconstruction came about. All other values are constants of the files that use them.

use serde::{Deserialize, Serialize};

/// Settings of the sparse front end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SparseConfig {
    /// Horizontal field of view, degrees, where it is known. Kept as it is.
    pub fov_deg: Option<f64>,
    /// Focal length in pixels of the input frames, where it is known. Kept as it is; takes precedence
    /// over `fov_deg`.
    pub focal_px: Option<f64>,
    /// True when the camera is known to be static: nothing is reconstructed.
    pub static_camera: bool,
    /// The lens where it is known: horizontal and vertical focal length and the principal point from the image's corner,
    /// pixels of the input frames. Kept as it is; takes precedence over `focal_px`. For callers in Rust.
    #[serde(skip)]
    pub intrinsics: Option<[f64; 4]>,
    /// Field of view assumed where the motion of the camera reveals nothing about it, degrees. 60: the main camera of common
    /// phones held upright to wide. For callers in Rust.
    #[serde(skip)]
    pub default_fov_deg: f64,
    /// Seed of the random samples. For callers in Rust.
    #[serde(skip)]
    pub seed: u64,
}

impl Default for SparseConfig {
    fn default() -> Self {
        Self { fov_deg: None, focal_px: None, static_camera: false, intrinsics: None, default_fov_deg: 60.0, seed: 0 }
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
    /// Nothing to hold on to.
    #[error(
        "only {found} points could be tracked from frame {frame} to the next, {needed} are needed (flat, dark or \
         blurred images, or a cut); cut the clip there, or pass --static-camera if the camera is static, or \
         supply a capture with poses"
    )]
    TooFewTracks {
        /// The frame at fault.
        frame: usize,
        /// Tracks that survive.
        found: usize,
        /// Tracks needed.
        needed: usize,
    },
    /// Two views could not be related although the image moves.
    #[error(
        "no two frames agree on a static scene: the best pair has {inliers} of {matches} points on one rigid motion, \
         {needed} are needed (do moving objects fill the image?); pass --fov with the true field of view, \
         --static-camera if the camera is static, or supply a capture with poses"
    )]
    NoStart {
        /// Points that agree.
        inliers: usize,
        /// Points seen in both frames.
        matches: usize,
        /// Points needed.
        needed: usize,
    },
    /// Frames were related, yet hardly anything fits the result.
    #[error(
        "only {points} of {tracks} tracks fit a static scene after bundle adjustment, {needed} are needed (moving \
         things fill the image?); pass --fov with the true field of view, --static-camera if the camera stands \
         still, or supply a capture with poses"
    )]
    TooFewPoints {
        /// Points that fit.
        points: usize,
        /// Tracks long enough to be judged.
        tracks: usize,
        /// Points needed.
        needed: usize,
    },
    /// Given poses that contradict the images.
    #[error(
        "the given poses do not fit the images: only {points} of {tracks} tracks agree with them on a static scene, \
         {needed} are needed; check the order of the frames, the direction (camera to world) and the axes of the poses, and \
         the focal length"
    )]
    PosesDoNotFit {
        /// Points that fit.
        points: usize,
        /// Tracks long enough to be judged.
        tracks: usize,
        /// Points needed.
        needed: usize,
    },
    /// Given poses that explain far less than others do.
    #[error(
        "the given poses contradict the images: {points} of {tracks} tracks agree with them on a static scene, {better} \
         with poses estimated from the images alone, whose rotations differ by up to {turn_deg:.1} degrees; check the order of \
         the frames, the direction (camera to world) and the axes of the poses, and the focal length, or leave the poses out"
    )]
    PosesRefuted {
        /// Points that fit the given poses.
        points: usize,
        /// Tracks long enough to be judged.
        tracks: usize,
        /// Points that fit the poses that were found.
        better: usize,
        /// Greatest difference of the turns since the first frame, degrees.
        turn_deg: f64,
    },
    /// The user stopped the run.
    #[error("stopped by the user")]
    Cancelled,
}
