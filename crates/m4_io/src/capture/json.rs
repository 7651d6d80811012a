//! The keys of `transforms*.json`.

use super::{Axes, ReadCaptureError};
use m4_core::Intrinsics;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Longest list of frames that is read, bytes: a frame takes under 2 kB, and a million frames are no clip.
const MAX_JSON_BYTES: u64 = 1 << 30;

/// Lens of all frames or of one; pixels.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Lens {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fl_x: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fl_y: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cx: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cy: Option<f64>,
    /// Some exporters write `480.0`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub w: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub h: Option<f64>,
    /// Horizontal field of view, radians: the synthetic NeRF scenes have it instead of `fl_x`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_angle_x: Option<f64>,
    #[serde(skip_serializing)]
    pub k1: Option<f64>,
    #[serde(skip_serializing)]
    pub k2: Option<f64>,
    #[serde(skip_serializing)]
    pub k3: Option<f64>,
    #[serde(skip_serializing)]
    pub k4: Option<f64>,
    #[serde(skip_serializing)]
    pub p1: Option<f64>,
    #[serde(skip_serializing)]
    pub p2: Option<f64>,
}

impl Lens {
    /// These values, and where they are missing those of `all`.
    pub fn or(&self, all: &Self) -> Self {
        // A focal length in one place must not mix with a field of view in the other.
        let own_focal = self.fl_x.is_some() || self.camera_angle_x.is_some();
        let focal = if own_focal { self } else { all };
        Self {
            fl_x: focal.fl_x,
            fl_y: focal.fl_y,
            camera_angle_x: focal.camera_angle_x,
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
        }
    }

    /// The pinhole of an image of `width` x `height` pixels, or what is wrong with these values.
    pub fn intrinsics(&self, (width, height): (usize, usize)) -> Result<Intrinsics, String> {
        let (w, h) = (width as f64, height as f64);
        let from_angle = |angle: f64| w / (2.0 * (angle / 2.0).tan());
        let fx = self.fl_x.or(self.camera_angle_x.map(from_angle));
        let fx = fx.ok_or_else(|| "fl_x, the focal length in pixels, is missing".to_owned())?;
        let fy = self.fl_y.unwrap_or(fx);
        for (key, focal) in [("fl_x", fx), ("fl_y", fy)] {
            if !(focal.is_finite() && focal > 0.0) {
                return Err(format!("{key} = {focal}; a focal length above 0 pixels was expected"));
            }
        }
        let (cx, cy) = (self.cx.unwrap_or(w / 2.0), self.cy.unwrap_or(h / 2.0));
        for (key, c, side) in [("cx", cx, w), ("cy", cy, h)] {
            // A crop may put the principal point outside of the image, but not far.
            if !(c.is_finite() && c >= -side && c <= 2.0 * side) {
                return Err(format!(
                    "{key} = {c}; the principal point of an image {side} pixels long was expected"
                ));
            }
        }
        Ok(Intrinsics {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
        })
    }

    /// The first distortion coefficient that is not 0.
    pub fn distortion(&self) -> Option<(&'static str, f64)> {
        let all = [
            ("k1", self.k1),
            ("k2", self.k2),
            ("k3", self.k3),
            ("k4", self.k4),
            ("p1", self.p1),
            ("p2", self.p2),
        ];
        all.into_iter()
            .filter_map(|(key, value)| Some((key, value?)))
            .find(|&(_, value)| value != 0.0)
    }
}

/// The file. Frames stay unparsed, so that a fault names its frame.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Transforms<F = serde_json::Value> {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_model: Option<String>,
    #[serde(flatten)]
    pub lens: Lens,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth_unit_scale_factor: Option<f64>,
    #[serde(default)]
    pub axes: Axes,
    #[serde(default)]
    pub metric: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_frames: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tracks_path: Option<String>,
    pub frames: Vec<F>,
}

/// One entry of `frames`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Frame {
    pub file_path: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth_file_path: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mask_path: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion_path: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance_path: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<u32>,
    #[serde(flatten)]
    pub lens: Lens,
    pub transform_matrix: Option<Vec<Vec<f64>>>,
}

/// Reads and parses the file, not its frames.
pub fn load(path: &Path) -> Result<Transforms, ReadCaptureError> {
    let io = |source| ReadCaptureError::Io {
        path: path.to_path_buf(),
        source,
    };
    let json = |reason: String| ReadCaptureError::Json {
        path: path.to_path_buf(),
        reason,
    };
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(io)?;
    file.take(MAX_JSON_BYTES + 1).read_to_end(&mut bytes).map_err(io)?;
    if bytes.len() as u64 > MAX_JSON_BYTES {
        return Err(json("it is larger than 1 GiB".into()));
    }
    serde_json::from_slice(&bytes).map_err(|e| {
        let line = e
            .line()
            .checked_sub(1)
            .and_then(|n| bytes.split(|&b| b == b'\n').nth(n));
        let line = String::from_utf8_lossy(line.unwrap_or_default());
        let hint = if line.contains("NaN") || line.contains("Infinity") {
            " (JSON has neither NaN nor Infinity; drop the frames whose pose was not found)"
        } else {
            ""
        };
        json(format!("{e}{hint}"))
    })
}
