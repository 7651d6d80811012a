//! Ground-truth cameras in the LLFF layout: `poses` of 3x5 matrices.

use m4_core::{
    Camera, Capture, CaptureFrame, Intrinsics, Plane, Se3,
    nalgebra::{Matrix3, Vector3},
};
use serde::Deserialize;

/// Why an LLFF file could not be used as truth.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LlffError {
    /// Not JSON, or no `poses` of numbers in it.
    #[error("not an LLFF pose file (a JSON object with \"poses\": [[[5 numbers] x 3] x frames])")]
    Parse {
        /// Where and why.
        #[source]
        source: serde_json::Error,
    },
    /// The list is empty.
    #[error("\"poses\" is empty; this file has no ground truth")]
    Empty,
    /// A pose that no camera has.
    #[error("pose {index}: {what} (found {value}); columns must be right, up, back, position, [height, width, focal]")]
    Bad {
        /// Index of the pose, from 0.
        index: usize,
        /// The fault.
        what: &'static str,
        /// The value at fault.
        value: f64,
    },
}

#[derive(Deserialize)]
struct File {
    poses: Vec<[[f64; 5]; 3]>,
}

/// Reads the cameras of an LLFF file (Mildenhall et al. 2019), given its text: a JSON object whose
/// `poses[i]` is 3x5, row by row; columns 0..3 are the camera's right, up and back axes in the
/// world, column 3 its centre, column 4 height, width and focal length in pixels. Other keys are
/// ignored.
///
/// The frames have no image (0x0), no depth and no mask; they are named `00000`, `00001`, ...
///
/// # Errors
///
/// [`LlffError`] if the text is not of that form or a pose is no rotation.
pub fn llff_truth(text: &str) -> Result<Capture, LlffError> {
    let file: File = serde_json::from_str(text).map_err(|source| LlffError::Parse { source })?;
    if file.poses.is_empty() {
        return Err(LlffError::Empty);
    }
    let count = file.poses.len();
    let frame = |(index, pose): (usize, &[[f64; 5]; 3])| {
        Ok(CaptureFrame {
            name: format!("{index:05}"),
            camera: camera(index, pose)?,
            t: index as f64,
            rgb: Plane::filled(0, 0, [0; 3]),
            depth: None,
            mask: None,
            motion: None,
            instances: None,
            camera_index: None,
        })
    };
    Ok(Capture {
        frames: file.poses.iter().enumerate().map(frame).collect::<Result<_, _>>()?,
        time_frames: count,
        duration_s: None,
        metric: false,
        tracks: None,
    })
}

fn camera(index: usize, pose: &[[f64; 5]; 3]) -> Result<Camera, LlffError> {
    let bad = |what, value| Err(LlffError::Bad { index, what, value });
    if let Some(&value) = pose.iter().flatten().find(|v| !v.is_finite()) {
        return bad("a number is not finite", value);
    }
    let column = |c: usize| Vector3::new(pose[0][c], pose[1][c], pose[2][c]);
    let (height, width, focal) = (pose[0][4], pose[1][4], pose[2][4]);
    for (what, value) in [("the height", height), ("the width", width)] {
        if value < 1.0 || value > f64::from(u16::MAX) || value.fract() != 0.0 {
            return bad(
                if what == "the height" {
                    "the height is not a valid number of pixels"
                } else {
                    "the width is not a valid number of pixels"
                },
                value,
            );
        }
    }
    if focal <= 0.0 {
        return bad("the focal length is not above 0", focal);
    }
    // OpenCV axes: right, down, forward.
    let rotation = Matrix3::from_columns(&[column(0), -column(1), -column(2)]);
    let skew = (rotation * rotation.transpose() - Matrix3::identity()).norm();
    if skew > 1e-3 {
        return bad("the axes are not orthonormal by", skew);
    }
    if rotation.determinant() < 0.0 {
        return bad("the axes are left-handed, determinant", rotation.determinant());
    }
    Ok(Camera {
        intrinsics: Intrinsics::centred(width as usize, height as usize, focal),
        c2w: Se3 {
            rotation,
            translation: column(3),
        },
    })
}

#[cfg(test)]
mod tests {
    use super::{LlffError, llff_truth};
    use m4_core::nalgebra::Vector3;

    #[test]
    fn a_camera_looks_along_minus_back() {
        let text = r#"{"poses": [[[1,0,0,5,48],[0,1,0,6,64],[0,0,1,7,50]]], "bds": [[1,2]]}"#;
        let capture = llff_truth(text).unwrap();
        let camera = capture.frames[0].camera;
        assert_eq!((camera.intrinsics.width, camera.intrinsics.height), (64, 48));
        assert_eq!(camera.centre(), Vector3::new(5.0, 6.0, 7.0));
        // The world's y is up here: a point ahead (-z) and above lands above the middle, in front.
        let ([u, v], z) = camera.project(&Vector3::new(5.0, 6.5, 5.0));
        assert!(z == 2.0 && (u - 31.5).abs() < 1e-12 && v < 23.5, "{u} {v} {z}");
    }

    #[test]
    fn malformed_llff_is_rejected() {
        assert!(matches!(llff_truth("{}"), Err(LlffError::Parse { .. })));
        assert!(matches!(llff_truth(r#"{"poses": []}"#), Err(LlffError::Empty)));
        let left = r#"{"poses": [[[-1,0,0,5,48],[0,1,0,6,64],[0,0,1,7,50]]]}"#;
        assert!(matches!(llff_truth(left), Err(LlffError::Bad { index: 0, .. })));
        let skewed = r#"{"poses": [[[1,0.1,0,5,48],[0,1,0,6,64],[0,0,1,7,50]]]}"#;
        assert!(matches!(llff_truth(skewed), Err(LlffError::Bad { .. })));
        let focal = r#"{"poses": [[[1,0,0,5,48],[0,1,0,6,64],[0,0,1,7,-50]]]}"#;
        assert!(matches!(llff_truth(focal), Err(LlffError::Bad { .. })));
    }

    #[test]
    fn the_real_clip_reads_and_moves_forward_in_time() {
        let Some(path) = m4_testkit::shared("clips/hand/precomputed.json") else {
            return;
        };
        let text = std::fs::read_to_string(path).unwrap();
        let capture = llff_truth(&text).unwrap();
        assert_eq!(capture.frames.len(), 86);
        let k = capture.frames[0].camera.intrinsics;
        assert_eq!((k.width, k.height), (512, 384));
        assert!((k.fx - 256.6).abs() < 1.0, "{}", k.fx);
        let report = crate::geometry::evaluate(&capture, &capture).unwrap();
        assert!(report.trajectory.unwrap().rmse < 1e-9);
    }
}
