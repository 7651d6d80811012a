//! The keys of the file.

use crate::capture::Axes;
use serde::Deserialize;
use serde::de::IgnoredAny;

/// Lens of all frames or of one; pixels.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default)]
pub struct LensKeys {
    pub fl_x: Option<f64>,
    pub fl_y: Option<f64>,
    pub cx: Option<f64>,
    pub cy: Option<f64>,
    /// Some exporters write `480.0`.
    pub w: Option<f64>,
    pub h: Option<f64>,
    pub camera_angle_x: Option<f64>,
    pub camera_angle_y: Option<f64>,
    pub k1: Option<f64>,
    pub k2: Option<f64>,
    pub k3: Option<f64>,
    pub k4: Option<f64>,
    pub p1: Option<f64>,
    pub p2: Option<f64>,
    pub camera_model: Option<String>,
    pub is_fisheye: Option<bool>,
}

impl LensKeys {
    /// These values, and where they are missing those of `all`.
    pub fn or(&self, all: &Self) -> Self {
        // a focal length in one place must not mix with a field of view in the other
        let own_focal = self.fl_x.is_some() || self.camera_angle_x.is_some();
        let focal = if own_focal { self } else { all };
        Self {
            fl_x: focal.fl_x,
            fl_y: focal.fl_y,
            camera_angle_x: focal.camera_angle_x,
            camera_angle_y: focal.camera_angle_y,
            cx: self.cx.or(all.cx),
            cy: self.cy.or(all.cy),
            w: self.w.or(all.w),
            h: self.h.or(all.h),
            k1: self.k1.or(all.k1),
            k2: self.k2.or(all.k2),
            k3: self.k3.or(all.k3),
            k4: self.k4.or(all.k4),
            p1: self.p1.or(all.p1),
            p2: self.p2.or(all.p2),
            camera_model: self.camera_model.clone().or_else(|| all.camera_model.clone()),
            is_fisheye: self.is_fisheye.or(all.is_fisheye),
        }
    }
}

/// The file. Frames stay unparsed, so that a fault names its frame.
#[derive(Debug, Clone, Deserialize)]
pub struct Transforms {
    #[serde(flatten)]
    pub lens: LensKeys,
    pub axes: Option<Axes>,
    pub depth_unit_scale_factor: Option<f64>,
    pub applied_transform: Option<Vec<Vec<f64>>>,
    pub applied_scale: Option<f64>,
    pub metric: Option<bool>,
    pub duration_s: Option<f64>,
    pub tracks_path: Option<String>,
    pub train_filenames: Option<Vec<String>>,
    pub val_filenames: Option<Vec<String>>,
    pub test_filenames: Option<Vec<String>>,
    pub orientation_override: Option<IgnoredAny>,
    pub aabb_scale: Option<IgnoredAny>,
    pub ply_file_path: Option<IgnoredAny>,
    pub frames: Option<Vec<serde_json::Value>>,
}

/// One entry of `frames`.
#[derive(Debug, Clone, Deserialize)]
pub struct Frame {
    #[serde(default)]
    pub file_path: String,
    pub depth_file_path: Option<String>,
    pub mask_path: Option<String>,
    pub motion_path: Option<String>,
    pub instance_path: Option<String>,
    pub time: Option<f64>,
    pub camera: Option<u32>,
    #[serde(flatten)]
    pub lens: LensKeys,
    pub transform_matrix: Option<Vec<Vec<f64>>>,
}
