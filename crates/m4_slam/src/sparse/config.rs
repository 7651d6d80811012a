//! Every constant of the sparse front end, with its source.

use serde::{Deserialize, Serialize};

/// How points are found and followed. Lengths are in working pixels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackingConfig {
    /// Frames are shrunk so that their longest side is at most this. 640: section 7.1.
    pub longest_side_px: usize,
    /// Side of the cells that hold at least one track each, where there is texture. 16 gives about
    /// 700 tracks on 480x360.
    pub cell_px: usize,
    /// New corners keep this distance from existing tracks.
    pub min_distance_px: f32,
    /// Corners weaker than this share of the strongest one are not used. Shi and Tomasi use 0.01 to
    /// 0.1; lower because cells already spread the corners.
    pub quality: f32,
    /// Corners with a lesser eigenvalue below this (squared grey levels) are noise.
    pub min_response: f32,
    /// Side of the patch that is followed; odd. Section 7.1 has 21; 11 gave trajectories as good or
    /// better, and is faster (docs/decisions/0001).
    pub window_px: usize,
    /// Levels of the pyramid, each half the size of the one below. 4: section 7.1.
    pub levels: usize,
    /// Gauss-Newton steps a level.
    pub iterations: usize,
    /// A point followed to the next frame and back must return this close. 0.7: section 7.1.
    pub max_round_trip_px: f32,
    /// Least normalised cross-correlation of a patch with itself one frame later.
    pub min_correlation: f32,
    /// Positions are aligned to the patch of an earlier frame while it correlates this much.
    pub anchor_correlation: f32,
    /// ... and while that moves the position by no more than this.
    pub max_drift_px: f32,
}

impl Default for TrackingConfig {
    fn default() -> Self {
        Self {
            longest_side_px: 640,
            cell_px: 16,
            min_distance_px: 6.0,
            quality: 0.001,
            min_response: 2.0,
            window_px: 11,
            levels: 4,
            iterations: 12,
            max_round_trip_px: 0.7,
            min_correlation: 0.7,
            anchor_correlation: 0.92,
            max_drift_px: 1.0,
        }
    }
}

/// How cameras and points are found. Lengths are in working pixels unless a name says otherwise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GeometryConfig {
    /// Fields of view tried where none is given. 12: section 7.1.
    pub fov_candidates: usize,
    /// Least horizontal field of view tried, degrees. 35: section 7.1.
    pub min_fov_deg: f64,
    /// Greatest horizontal field of view tried, degrees. 100: section 7.1.
    pub max_fov_deg: f64,
    /// Field of view assumed where the motion of the camera reveals nothing about it, degrees: the
    /// main camera of common phones held upright to wide.
    pub default_fov_deg: f64,
    /// A frame becomes a keyframe when the median parallax to the last one, rotation taken out,
    /// exceeds this share of the image width. 0.015: section 7.1.
    pub keyframe_parallax: f64,
    /// ... or when fewer than this share of the last keyframe's tracks are still seen.
    pub keyframe_survival: f64,
    /// Most keyframes; the clip is cut into this many where more are asked for.
    pub max_keyframes: usize,
    /// Below this greatest median parallax (share of the width, rotation taken out) nothing can be
    /// triangulated and the camera counts as turning only. 0.004: 2 pixels of 480, some twenty times
    /// the error of a track.
    pub min_parallax: f64,
    /// Below this motion of three quarters of all tracks over the clip the camera counts as still.
    pub static_motion_px: f64,
    /// Random samples of five tracks a pair and field of view.
    pub two_view_samples: usize,
    /// Epipolar and reprojection errors above this do not count as agreement.
    pub inlier_px: f64,
    /// Scale of the Cauchy loss of bundle adjustment while the map grows.
    pub cauchy_px: f64,
    /// ... and, once all frames are placed, this many robust standard deviations of the residuals.
    /// 2.385: 95 % efficiency on normal errors (Holland and Welsch 1977).
    pub cauchy_deviations: f64,
    /// Points whose rays meet at less than this are not triangulated, degrees. 1.5: section 7.1. In
    /// clips with so little parallax that this would leave few points, half the angle that the
    /// greatest median parallax stands for.
    pub min_angle_deg: f64,
    /// Steps of the final bundle adjustments.
    pub bundle_iterations: usize,
    /// Bundle adjustment ends when a step lowers the loss by less than this share.
    pub bundle_tolerance: f64,
    /// Seed of the random samples.
    pub seed: u64,
}

impl Default for GeometryConfig {
    fn default() -> Self {
        Self {
            fov_candidates: 12,
            min_fov_deg: 35.0,
            max_fov_deg: 100.0,
            default_fov_deg: 60.0,
            keyframe_parallax: 0.015,
            keyframe_survival: 0.6,
            max_keyframes: 40,
            min_parallax: 0.004,
            static_motion_px: 1.0,
            two_view_samples: 150,
            inlier_px: 2.0,
            cauchy_px: 1.0,
            cauchy_deviations: 2.385,
            min_angle_deg: 1.5,
            bundle_iterations: 30,
            bundle_tolerance: 1e-6,
            seed: 0,
        }
    }
}

/// Median of the length of a residual whose two components have standard deviation 1 (Rayleigh).
pub(super) const RAYLEIGH_MEDIAN: f64 = 1.177_41;

impl GeometryConfig {
    /// Narrows the loss to residuals with this median, pixels: what a wide loss lets pass (slow
    /// motion, patches on two surfaces) would pull at the focal length. Never under 0.05 pixels.
    pub(super) fn sharpen(&mut self, median_px: f64) {
        let scale = self.cauchy_deviations * median_px / RAYLEIGH_MEDIAN;
        self.cauchy_px = self.cauchy_px.min(scale.max(0.05));
    }
}

/// When a track counts as moving.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MotionConfig {
    /// Residuals above this many robust standard deviations disagree. 3: section 7.1.
    pub deviations: f64,
    /// ... if they are also above this, working pixels. 1: section 7.1.
    pub min_residual_px: f64,
    /// A track moves when at least this share of its observations disagrees. 0.3: section 7.1.
    pub share: f64,
    /// Tracks with fewer observations are not judged. 3: the first number with more than one equation
    /// to spare.
    pub min_observations: usize,
    /// How often classification and bundle adjustment alternate. 2: section 7.1.
    pub rounds: usize,
}

impl Default for MotionConfig {
    fn default() -> Self {
        Self {
            deviations: 3.0,
            min_residual_px: 1.0,
            share: 0.3,
            min_observations: 3,
            rounds: 2,
        }
    }
}

/// What the user knows, and all constants.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SparseConfig {
    /// Horizontal field of view, degrees, where it is known. Kept as it is.
    pub fov_deg: Option<f64>,
    /// Focal length in pixels of the input frames, where it is known. Kept as it is; takes precedence
    /// over `fov_deg`.
    pub focal_px: Option<f64>,
    /// The lens where it is known: horizontal and vertical focal length and the principal point from the image's corner,
    /// pixels of the input frames. Kept as it is; takes precedence over `focal_px`.
    pub intrinsics: Option<[f64; 4]>,
    /// True when the camera is known to stand still: nothing is reconstructed.
    pub static_camera: bool,
    /// How points are found and followed.
    pub tracking: TrackingConfig,
    /// How cameras and points are found.
    pub geometry: GeometryConfig,
    /// When a track counts as moving.
    pub motion: MotionConfig,
}
