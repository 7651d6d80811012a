//! Poses in the LLFF layout (Mildenhall et al. 2019): 3x5 matrices whose last column is height, width and focal length in pixels.
//!
//! ```text
//! poses_bounds.npy   [n][17]: the matrix (columns down, right, back, place), row by row, then the nearest and farthest depth
//! JSON               "poses": [n][3][5] (columns right, up, back, place); other keys are ignored
//! ```

use crate::error::AtPath;
use crate::files::json;
use crate::npy::Numbers;
use crate::{Fault, ReadError, pose};
use m4_core::{Camera, Capture, CaptureFrame, Intrinsics, Plane};
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::path::Path;

/// Numbers per camera.
const WIDTH: usize = 17;
/// Largest array: a hundred thousand cameras.
const MAX_BYTES: u64 = 16 << 20;
const HINT: &str = "make the file of poses again";

/// A row of `poses_bounds.npy`.
pub(super) struct Pose {
    /// Of images of the full size.
    pub camera: Camera,
    /// Depth in view, scene units.
    pub near: f64,
    pub far: f64,
}

/// Reads `poses_bounds.npy`: one row per camera, at least one.
pub(super) fn read_bounds(path: &Path) -> Result<Vec<Pose>, ReadError> {
    let array = Numbers::read(path, MAX_BYTES).at(path)?;
    match array.shape[..] {
        [n, WIDTH] if n > 0 => {}
        _ => {
            let what = format!("an array of shape {:?}; [cameras, 17] was expected", array.shape);
            return Err(Fault::bad(what, HINT).at(path));
        }
    }
    let one = |row: &[f64; WIDTH]| {
        let m = [0, 1, 2].map(|i| [0, 1, 2, 3, 4].map(|j| row[5 * i + j]));
        let camera = camera(m.map(|r| [r[1], r[0], -r[2]]), &m)?;
        let (near, far) = (row[15], row[16]);
        if !(near > 0.0 && far > near && far.is_finite()) {
            return Err(Fault::bad(format!("depth from {near} to {far}; 0 < near < far was expected"), HINT));
        }
        Ok(Pose { camera, near, far })
    };
    let rows = array.values.as_chunks::<WIDTH>().0.iter().enumerate();
    rows.map(|(i, row)| one(row).map_err(|e| e.within(path, format!("camera {i}")))).collect()
}

#[derive(Deserialize)]
struct File {
    poses: Vec<[[f64; 5]; 3]>,
}

/// Whether a file is JSON with `poses` and without `frames`.
#[must_use]
pub fn detect(path: &Path) -> bool {
    #[derive(Deserialize)]
    struct Keys {
        poses: Option<IgnoredAny>,
        frames: Option<IgnoredAny>,
    }
    matches!(json(path), Ok(Keys { poses: Some(_), frames: None }))
}

/// Reads the cameras of a JSON file; the frames have no image (0x0), depth or mask and are named `00000`, `00001`, ...
pub fn read(path: &Path) -> Result<Capture, ReadError> {
    let File { poses } = json(path)?;
    if poses.is_empty() {
        return Err(Fault::bad("\"poses\" is empty", HINT).at(path));
    }
    let time_frames = poses.len();
    let frame = |(i, m): (usize, [[f64; 5]; 3])| {
        let camera = camera(m.map(|r| [r[0], -r[1], -r[2]]), &m);
        Ok(CaptureFrame {
            name: format!("{i:05}"),
            camera: camera.map_err(|e| e.within(path, format!("pose {i}")))?,
            t: i as f64,
            rgb: Plane::filled(0, 0, [0; 3]),
            depth: None,
            mask: None,
            motion: None,
            instances: None,
            camera_index: None,
        })
    };
    Ok(Capture {
        frames: poses.into_iter().enumerate().map(frame).collect::<Result<_, _>>()?,
        time_frames,
        duration_s: None,
        metric: false,
        tracks: None,
    })
}

/// A camera by its axes right, down, forward, and the other columns of the matrix.
fn camera(axes: [[f64; 3]; 3], m: &[[f64; 5]; 3]) -> Result<Camera, Fault> {
    let c2w = pose::of_rotation(axes, [0, 1, 2].map(|i| m[i][3]))?;
    let [height, width, focal] = [0, 1, 2].map(|i| m[i][4]);
    let side = |v: f64| (v.fract() == 0.0 && (1.0..=65536.0).contains(&v)).then_some(v as usize);
    let (Some(w), Some(h)) = (side(width), side(height)) else {
        return Err(Fault::bad(format!("images of {width} x {height} pixels"), HINT));
    };
    if !(focal.is_finite() && focal > 0.0) {
        return Err(Fault::bad(format!("the focal length {focal}; pixels, above 0, were expected"), HINT));
    }
    Ok(Camera { intrinsics: Intrinsics::centred(w, h, focal), c2w })
}

#[cfg(test)]
mod tests {
    use super::{detect, read};
    use m4_core::nalgebra::Vector3;

    fn file(text: &str) -> tempfile::NamedTempFile {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        file
    }

    #[test]
    fn a_json_camera_looks_along_minus_back() {
        let text = file(r#"{"poses": [[[1,0,0,5,48],[0,1,0,6,64],[0,0,1,7,50]]], "bds": [[1,2]]}"#);
        assert!(detect(text.path()) && !detect(file(r#"{"poses": [], "frames": []}"#).path()));
        let camera = read(text.path()).unwrap().frames[0].camera;
        assert_eq!((camera.intrinsics.width, camera.intrinsics.height), (64, 48));
        assert_eq!(camera.centre(), Vector3::new(5.0, 6.0, 7.0));
        // the world's y is up here: a point ahead (-z) and above lands above the middle, in front
        let ([u, v], z) = camera.project(&Vector3::new(5.0, 6.5, 5.0));
        assert!(z == 2.0 && (u - 31.5).abs() < 1e-12 && v < 23.5, "{u} {v} {z}");
    }

    #[test]
    fn malformed_json_poses_are_rejected() {
        for (poses, reason) in [
            ("", "empty"),
            ("[[-1,0,0,5,48],[0,1,0,6,64],[0,0,1,7,50]]", "pose 0"),
            ("[[1,0.1,0,5,48],[0,1,0,6,64],[0,0,1,7,50]]", "not a rotation"),
            ("[[1,0,0,5,48],[0,1,0,6,64],[0,0,1,7,-50]]", "focal length -50"),
            ("[[1,0,0,5,4.5],[0,1,0,6,64],[0,0,1,7,50]]", "64 x 4.5"),
            ("[[1,0,0,5]]", "JSON"),
        ] {
            let text = file(&format!(r#"{{"poses": [{poses}]}}"#));
            let error = read(text.path()).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
    }

    #[test]
    fn shared_clip_has_poses_for_86_frames() {
        let Some(path) = m4_testkit::shared("clips/hand/precomputed.json") else {
            return;
        };
        let capture = read(&path).unwrap();
        assert_eq!(capture.frames.len(), 86);
        let k = capture.frames[0].camera.intrinsics;
        assert_eq!((k.width, k.height), (512, 384));
        assert!((k.fx - 256.6).abs() < 1.0, "{}", k.fx);
    }
}
