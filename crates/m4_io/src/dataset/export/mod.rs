//! Parts common to the writers of captures for other tools ([`super::colmap::write`], [`super::nerfstudio::write`]).
//!
//! ```text
//! capture -> points of static regions, images, masks, depth -> a folder beside its place -> read back -> its name
//! ```
//!
//! The dynamic part is 0 in the masks of both folders and left out of the points: their readers rebuild the static part.

pub(super) mod images;

mod points;
mod staging;

pub(super) use images::FramePaths;
pub(super) use points::static_points;
pub(super) use staging::Staging;

use crate::ErrorKind;
use crate::image::{ReadImageError, WriteImageError};
use crate::scene::WriteFileError;
use crate::scene::cameras_check::usable;
use m4_core::{Capture, Exposure, SourceFrame};
use std::path::{Path, PathBuf};

/// Why a capture could not be written for another tool.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteCaptureAsError {
    /// A file did not get to the disk as it was made.
    #[error(transparent)]
    File(#[from] WriteFileError),
    /// An image could not be written.
    #[error(transparent)]
    Image(#[from] WriteImageError),
    /// An image that was written could not be read again.
    #[error("an image was written but does not read back: {0}; check the disk")]
    ReadBack(#[from] ReadImageError),
    /// The capture holds what the format cannot, or nothing.
    #[error("cannot write {}: {what}", path.display())]
    BadCapture {
        /// The file or folder.
        path: PathBuf,
        /// The fault, and where it is.
        what: String,
    },
    /// The caller asked to stop; nothing was left.
    #[error("stopped while writing {}", path.display())]
    Cancelled {
        /// The file or folder.
        path: PathBuf,
    },
}

impl WriteCaptureAsError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::BadCapture { .. } => ErrorKind::BadData,
            Self::Image(e) => e.kind(),
            _ => ErrorKind::CannotWrite,
        }
    }
}

/// Refuses captures without frames, and invalid cameras.
pub(super) fn check(out: &Path, capture: &Capture) -> Result<(), WriteCaptureAsError> {
    let bad = |what: String| WriteCaptureAsError::BadCapture {
        path: out.to_path_buf(),
        what,
    };
    if capture.frames.is_empty() {
        return Err(bad("the capture has no frames".to_owned()));
    }
    let last = capture.time_frames.max(2) as f64 - 1.0;
    for (i, frame) in capture.frames.iter().enumerate() {
        if !(0.0..=last).contains(&frame.t) {
            return Err(bad(format!(
                "frame {i} ({}) was taken at t = {}; 0 to {last} frames were expected",
                frame.name, frame.t
            )));
        }
        let maps = [
            frame.depth.as_ref().map(|d| d.size()),
            frame.mask.as_ref().map(|m| m.size()),
        ];
        if maps.into_iter().flatten().any(|(w, h)| w == 0 || h == 0) {
            return Err(bad(format!(
                "a depth map or mask of frame {i} ({}) has no pixels",
                frame.name
            )));
        }
        let camera = frame.camera;
        let seen = SourceFrame {
            camera,
            t: frame.t,
            exposure: Exposure::IDENTITY,
        };
        if !usable(&seen) {
            return Err(bad(format!(
                "the camera of frame {i} ({}) is none: {camera:?}",
                frame.name
            )));
        }
        let k = &camera.intrinsics;
        if frame.rgb.size() != (k.width, k.height) {
            let (w, h) = frame.rgb.size();
            return Err(bad(format!(
                "the image of frame {i} ({}) is {w} x {h} pixels and its camera {} x {}",
                frame.name, k.width, k.height
            )));
        }
    }
    Ok(())
}
