//! What callers know of the camera. All other values are constants of the files that use them.

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
        Self {
            fov_deg: None,
            focal_px: None,
            static_camera: false,
            intrinsics: None,
            default_fov_deg: 60.0,
            seed: 0,
        }
    }
}
