//! The classical front end: geometry without weights.
//!
//! ```text
//! frames -> sparse (feature tracks, structure from motion) -> dense (flow, plane sweep, motion segmentation) -> depth and masks
//! ```
//!
//! `sparse` and `dense` meet in the types of this module alone, so either can be replaced;
//! `again` decides about a second pass, and `confidence` grades the result.

pub mod again;
pub mod confidence;
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

impl SparseReconstruction {
    /// The reconstruction with all lengths times `by`.
    #[must_use]
    pub fn scaled(&self, by: f64) -> Self {
        let mut scaled = self.clone();
        for camera in &mut scaled.cameras {
            camera.c2w.translation *= by;
        }
        for point in scaled.tracks.iter_mut().filter_map(|t| t.point.as_mut()) {
            *point *= by;
        }
        scaled
    }

    /// The reconstruction of the frames with these indices, in ascending order: their cameras, and
    /// the tracks that any of them shows.
    #[must_use]
    pub fn at_frames(&self, frames: &[usize]) -> Self {
        let track = |track: &Track| {
            let first_frame = frames.partition_point(|&i| i < track.first_frame);
            let observations: Vec<[f32; 2]> = frames[first_frame..]
                .iter()
                .map_while(|&i| track.at(i))
                .collect();
            (!observations.is_empty()).then_some(Track {
                first_frame,
                observations,
                ..*track
            })
        };
        Self {
            cameras: frames.iter().map(|&i| self.cameras[i]).collect(),
            tracks: self.tracks.iter().filter_map(track).collect(),
            warnings: self.warnings.clone(),
            ..*self
        }
    }
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

#[cfg(test)]
mod tests {
    use super::{CameraMotion, Motion, SparseReconstruction, Track};
    use m4_core::{Camera, Intrinsics, Se3, nalgebra::Vector3};

    #[test]
    fn a_reconstruction_of_some_frames_has_their_cameras_and_what_they_show() {
        let camera = |i: usize| Camera {
            intrinsics: Intrinsics::centred(64, 48, 50.0),
            c2w: Se3 {
                translation: Vector3::new(i as f64, 0.0, 0.0),
                ..Se3::identity()
            },
        };
        let track = |first_frame: usize, count: usize| Track {
            first_frame,
            observations: (0..count)
                .map(|k| [(first_frame + k) as f32, 0.0])
                .collect(),
            motion: Motion::Static,
            point: Some(Vector3::zeros()),
            residual_px: 0.1,
        };
        let all = SparseReconstruction {
            cameras: (0..10).map(camera).collect(),
            tracks: vec![track(0, 10), track(1, 2), track(4, 3), track(7, 3)],
            camera_motion: CameraMotion::Parallax,
            residual_px: 0.1,
            warnings: Vec::new(),
        };
        let some = all.at_frames(&[0, 3, 6, 9]);
        let places: Vec<f64> = some.cameras.iter().map(|c| c.centre().x).collect();
        assert_eq!(places, [0.0, 3.0, 6.0, 9.0]);
        let shown: Vec<(usize, Vec<f32>)> = some
            .tracks
            .iter()
            .map(|t| (t.first_frame, t.observations.iter().map(|o| o[0]).collect()))
            .collect();
        // the second track lies between two of the frames
        let want = [
            (0, vec![0.0, 3.0, 6.0, 9.0]),
            (2, vec![6.0]),
            (3, vec![9.0]),
        ];
        assert_eq!(shown, want);
    }
}
