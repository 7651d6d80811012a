//! Errors of an export, except for files that cannot be written.

use super::Format;
use crate::Category;
use m4_io::cameras::colmap::WriteColmapError;
use m4_io::cameras::nerfstudio::WriteNerfstudioError;
use m4_io::captures::WriteCaptureAsError;
use m4_io::scene::fourdgs::WriteFourdgsError;
use m4_io::scene::gltf::WriteGltfError;
use m4_io::scene::ply::WritePlyError;
use m4_io::scene::splatv::WriteSplatvError;
use m4_io::scene::spz::WriteSpzError;
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
    /// Writing a capture for another tool.
    #[error(transparent)]
    Capture(#[from] WriteCaptureAsError),
    /// Writing `.4dgs`.
    #[error(transparent)]
    Fourdgs(#[from] WriteFourdgsError),
    /// Writing PLY.
    #[error(transparent)]
    Ply(#[from] WritePlyError),
    /// Writing `.splatv`.
    #[error(transparent)]
    Splatv(#[from] WriteSplatvError),
    /// Writing SPZ.
    #[error(transparent)]
    Spz(#[from] WriteSpzError),
    /// Writing glTF.
    #[error(transparent)]
    Gltf(#[from] WriteGltfError),
    /// Writing a COLMAP model.
    #[error(transparent)]
    Colmap(#[from] WriteColmapError),
    /// Writing `transforms.json`.
    #[error(transparent)]
    Nerfstudio(#[from] WriteNerfstudioError),
}

impl ExportError {
    /// What sort of failure this is.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::NoInstant { .. } | Self::NoRate { .. } | Self::Unknown { .. } => Category::Usage,
            Self::NoCameras | Self::NeedsScene { .. } => Category::BadInput,
            Self::Capture(e) => e.kind().into(),
            Self::ReadBack { .. } => Category::Internal,
            Self::Fourdgs(e) => e.kind().into(),
            Self::Ply(e) => e.kind().into(),
            Self::Splatv(e) => e.kind().into(),
            Self::Spz(e) => e.kind().into(),
            Self::Gltf(e) => e.kind().into(),
            Self::Colmap(e) => e.kind().into(),
            Self::Nerfstudio(e) => e.kind().into(),
        }
    }
}
