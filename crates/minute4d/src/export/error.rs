//! Errors of an export, except for files that cannot be written.

use super::Format;
use crate::Category;
use std::path::PathBuf;

/// Why an export failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// A moment for a format that has all of them.
    #[error("--time has no meaning for {}, which holds the whole clip; leave it out, or choose a format of one instant such as ply", format.name())]
    NoInstant {
        /// The format.
        format: Format,
    },
    /// A rate for a format without frames.
    #[error("--fps has no meaning for {}; leave it out, or choose ply-sequence or mp4", format.name())]
    NoRate {
        /// The format.
        format: Format,
    },
    /// A capture for a format that holds a scene.
    #[error("{} is a capture, which the format {} cannot store; choose colmap or nerfstudio, or train it first (`minute4d train`)", path.display(), format.name())]
    NeedsScene {
        /// The format.
        format: Format,
        /// The capture.
        path: PathBuf,
    },
    /// A scene for a format that holds a capture.
    #[error("the format {} stores captures, not scenes; give the folder of a capture, or choose a format of scenes such as ply", format.name())]
    NeedsCapture {
        /// The format.
        format: Format,
    },
    /// A format that is not known.
    #[error("{given:?} is not a format; choose one of {}", Format::names())]
    Unknown {
        /// The given text.
        given: String,
    },
    /// A video of a scene without cameras.
    #[error("the scene has no cameras to render it from; render it along a path, such as --path swing")]
    NoCameras,
    /// The file that was written could not be read back for the comparison.
    #[error("the {} file was written but does not read back; this is a bug, please report it: {source}", format.name())]
    ReadBack {
        /// The format.
        format: Format,
        /// The reason.
        source: Box<crate::import::ImportError>,
    },
}

impl ExportError {
    /// What sort of failure this is.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::NoInstant { .. } | Self::NoRate { .. } | Self::Unknown { .. } => Category::Usage,
            Self::NoCameras | Self::NeedsScene { .. } | Self::NeedsCapture { .. } => Category::BadInput,
            Self::ReadBack { .. } => Category::Internal,
        }
    }
}
