//! `transforms.json`: nerfstudio, the synthetic scenes of NeRF and D-NeRF, Instant4D, instant-ngp,
//! and our own captures.
//!
//! ```text
//! PATH                    a JSON file, or a folder with transforms_train.json (and transforms_test.json, or _val) or transforms.json
//! fl_x fl_y cx cy w h     pixels, for all frames or inside one; or camera_angle_x (_y), the field of view, radians
//! camera_model, k1 .. k4, p1, p2, is_fisheye       distortion, which is removed
//! applied_transform, applied_scale                 what was done to the poses after they were computed; it is undone
//! train_filenames, val_filenames, test_filenames   which frames are held out
//! axes, metric, duration_s, tracks_path, depth_unit_scale_factor      of our own captures (crate::capture)
//! frames[]  file_path, transform_matrix, time (0..1), depth_file_path, mask_path, motion_path, instance_path, camera
//!
//! this module   the keys as they are in the file, and the lens of a frame
//! list     entries -> frames
//! ```
//!
//! **What is converted.**
//!
//! * Axes. Matrices are camera to world. They are OpenGL's (x right, y up, z back) except where
//!   `axes` says `opencv`. Where it is missing: a file with one of the keys `camera_angle_x`,
//!   `camera_model`, `applied_transform`, `orientation_override`, `aabb_scale`, `ply_file_path` or
//!   `is_fisheye` is one of nerfstudio, Blender or instant-ngp, and OpenGL. A file without any of
//!   them whose frames all have a `time` is laid out as those of Instant4D, whose axes are
//!   OpenCV's; it is taken so, and a warning says it. All others are OpenGL.
//! * Time. `time` runs from 0 to 1 over the training video. Without it frames are in the natural
//!   order of their names, evenly spaced.
//! * Depth. PNG files of 16 bits, and numbers of npy and EXR files too, are multiplied by
//!   `depth_unit_scale_factor` (0.001 where it is missing, as in nerfstudio).
//! * Masks. nerfstudio trains where `mask_path` is not 0 and leaves out what is 0: the dynamic part
//!   is **0**. Our own captures, known by the key `axes`, have 255 there.
//! * `applied_scale` and `applied_transform` are undone, so that poses are again in the unit of the
//!   depth maps and in the world of the tool that computed them.
//! * The principal point is measured from the image's corner, as ours. `k4` of a lens that is no
//!   fisheye is not read: programs disagree about what it is.
//!
//! Source: nerfstudio's `nerfstudio_dataparser.py`, `depth_dataset.py` and `data_utils.py`
//! (Apache-2.0), `blender_dataparser.py`.

mod axes;
mod list;

pub(crate) use list::list_capture;
pub(super) use list::{detect, list};

use super::{Distortion, Lens};
use crate::pose::Axes;
use crate::{Fault, range};
use m4_core::{Intrinsics, Se3};
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

/// The file that lists the training frames where held-out views have a file of their own.
pub(crate) const TRAINING_LIST: &str = "transforms_train.json";

/// Lens of all frames or of one; pixels.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct LensKeys {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_model: Option<String>,
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
    #[serde(skip_serializing)]
    pub camera_angle_x: Option<f64>,
    #[serde(skip_serializing)]
    pub camera_angle_y: Option<f64>,
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
    #[serde(skip_serializing)]
    pub is_fisheye: Option<bool>,
}

impl LensKeys {
    /// The keys of a pinhole.
    pub fn pinhole(k: &Intrinsics) -> Self {
        Self {
            fl_x: Some(k.fx),
            fl_y: Some(k.fy),
            cx: Some(k.cx),
            cy: Some(k.cy),
            w: Some(k.width as f64),
            h: Some(k.height as f64),
            ..Self::default()
        }
    }

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
            camera_model: self
                .camera_model
                .clone()
                .or_else(|| all.camera_model.clone()),
            is_fisheye: self.is_fisheye.or(all.is_fisheye),
        }
    }
}

/// The file. Frames that are read stay unparsed, so that a fault names its frame.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(default, bound(deserialize = "F: Deserialize<'de> + Default"))]
pub(crate) struct Transforms<F = serde_json::Value> {
    #[serde(flatten)]
    pub lens: LensKeys,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_unit_scale_factor: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axes: Option<Axes>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metric: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_frames: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tracks_path: Option<String>,
    #[serde(skip_serializing)]
    pub train_filenames: Option<Vec<String>>,
    #[serde(skip_serializing)]
    pub val_filenames: Option<Vec<String>>,
    #[serde(skip_serializing)]
    pub test_filenames: Option<Vec<String>>,
    #[serde(skip_serializing)]
    pub ply_file_path: Option<IgnoredAny>,
    #[serde(skip_serializing)]
    pub applied_transform: Option<Vec<Vec<f64>>>,
    #[serde(skip_serializing)]
    pub applied_scale: Option<f64>,
    #[serde(skip_serializing)]
    pub orientation_override: Option<IgnoredAny>,
    #[serde(skip_serializing)]
    pub aabb_scale: Option<IgnoredAny>,
    pub frames: Vec<F>,
}

/// One entry of `frames`.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Frame {
    pub file_path: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_file_path: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mask_path: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion_path: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instance_path: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distance_sigma: Option<f32>,
    #[serde(flatten)]
    pub lens: LensKeys,
    pub transform_matrix: Option<Vec<Vec<f64>>>,
}

/// The rows of `transform_matrix` of a pose: OpenGL axes.
pub(crate) fn rows(c2w: &Se3<f64>) -> Vec<Vec<f64>> {
    let m = Axes::OpenGl.to_opencv(c2w).matrix();
    (0..4)
        .map(|i| (0..4).map(|j| m[(i, j)]).collect())
        .collect()
}

/// Reads the lens in `json`: `transforms.json`, or a file with its keys of the lens alone. `size`
/// is that of images where the file states none, pixels.
///
/// # Errors
///
/// [`Fault`]: no such JSON, no focal length, a value out of range, or a lens model that is not read.
pub fn lens_in(json: &[u8], size: (usize, usize)) -> Result<Lens, Fault> {
    let keys: LensKeys = serde_json::from_slice(json).map_err(|e| {
        let hint = "give a file with fl_x, fl_y, cx, cy, w, h and, where the lens has distortion, its \
                    coefficients";
        Fault::bad(format!("it is not such JSON ({e})"), hint)
    })?;
    let side = |key: &str, stated: Option<f64>, default: usize| match stated {
        Some(side) if (1.0..=65_536.0).contains(&side) => Ok(side.round() as usize),
        Some(side) => Err(Fault::bad(format!("{key} = {side}"), HINT)),
        None => Ok(default),
    };
    let size = (side("w", keys.w, size.0)?, side("h", keys.h, size.1)?);
    lens_of(&keys, size)
}

const HINT: &str = "correct the intrinsics in the file";

/// The lens of an image of that size.
pub(crate) fn lens_of(keys: &LensKeys, (width, height): (usize, usize)) -> Result<Lens, Fault> {
    let (w, h) = (width as f64, height as f64);
    for (key, stated, actual) in [("w", keys.w, w), ("h", keys.h, h)] {
        if let Some(stated) = stated.filter(|stated| (stated - actual).abs() > 0.5) {
            let what = format!("{key} = {stated}, but the image has {actual}");
            return Err(Fault::bad(
                what,
                "use the images that the cameras were computed from",
            ));
        }
    }
    let from_angle = |key: &str, angle: f64, side: f64| {
        if angle > 0.0 && angle < std::f64::consts::PI {
            return Ok(side / (2.0 * (angle / 2.0).tan()));
        }
        Err(Fault::bad(
            format!("{key} = {angle}; a field of view from 0 to pi radians was expected"),
            HINT,
        ))
    };
    let fx = match (keys.fl_x, keys.camera_angle_x) {
        (Some(fx), _) => fx,
        (None, Some(angle)) => from_angle("camera_angle_x", angle, w)?,
        (None, None) => {
            return Err(Fault::missing(
                "fl_x, the focal length in pixels (or camera_angle_x),",
                "add it to the file",
            ));
        }
    };
    let fy = match (keys.fl_y, keys.fl_x, keys.camera_angle_y) {
        (Some(fy), _, _) => fy,
        (None, None, Some(angle)) => from_angle("camera_angle_y", angle, h)?,
        _ => fx,
    };
    for (key, focal) in [("fl_x", fx), ("fl_y", fy)] {
        if let Some(what) = range::of_pixels(key, focal, &range::FOCAL, width.max(height)) {
            return Err(Fault::bad(what, HINT));
        }
    }
    let lens = Lens {
        intrinsics: Intrinsics {
            width,
            height,
            fx,
            fy,
            cx: keys.cx.unwrap_or(w / 2.0),
            cy: keys.cy.unwrap_or(h / 2.0),
        },
        distortion: distortion(keys)?,
    };
    lens.check()?;
    Ok(lens)
}

fn distortion(keys: &LensKeys) -> Result<Distortion, Fault> {
    let value = |key: Option<f64>| key.unwrap_or(0.0);
    let k = [keys.k1, keys.k2, keys.k3, keys.k4].map(value);
    let (p1, p2) = (value(keys.p1), value(keys.p2));
    let model = keys.camera_model.as_deref().unwrap_or("OPENCV");
    let fisheye = keys.is_fisheye == Some(true) || matches!(model, "OPENCV_FISHEYE" | "FISHEYE");
    if fisheye {
        if (p1, p2) != (0.0, 0.0) {
            return Err(Fault::unsupported(
                format!("a fisheye with p1 = {p1}, p2 = {p2}"),
                "undistort the images",
            ));
        }
        return Ok(Distortion::Fisheye { k });
    }
    match model {
        "SIMPLE_PINHOLE" | "PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "OPENCV" | "PERSPECTIVE" => {}
        other => {
            let hint = "PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV and OPENCV_FISHEYE are read; undistort the images";
            return Err(Fault::unsupported(
                format!("camera_model is {other:?}"),
                hint,
            ));
        }
    }
    if k[3] != 0.0 {
        let what = format!("k4 = {} of a lens that is not a fisheye", k[3]);
        return Err(Fault::unsupported(
            what,
            "undistort the images and set it to 0",
        ));
    }
    Ok(Distortion::brown(k[0], k[1], k[2], p1, p2))
}
