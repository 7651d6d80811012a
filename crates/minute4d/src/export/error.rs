//! Why an export failed, beside the files that could not be written.

use super::Format;
use crate::Category;
use m4_formats::cameras::colmap::WriteColmapError;
use m4_formats::cameras::nerfstudio::WriteNerfstudioError;
use m4_formats::fourdgs::WriteFourdgsError;
use m4_formats::gltf::WriteGltfError;
use m4_formats::ply::WritePlyError;
use m4_formats::splatv::WriteSplatvError;
use m4_formats::spz::WriteSpzError;
use m4_formats::usd::WriteUsdError;

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
    #[error("--fps has no meaning for {}, which has no frames; leave it out, or choose ply-sequence, usd or mp4", format.name())]
    NoRate {
        /// The format.
        format: Format,
    },
    /// A format that is not known.
    #[error("{given:?} is no format; choose one of {}", Format::names())]
    Unknown {
        /// What was written.
        given: String,
    },
    /// A video of a scene without cameras.
    #[error(
        "the scene has no cameras, so there is nothing to see it from; render it along a path, such as --path swing"
    )]
    NoCameras,
    /// The file that was written could not be read back for the comparison.
    #[error("the {} file was written but does not read back; this is a bug, please report it: {source}", format.name())]
    ReadBack {
        /// The format.
        format: Format,
        /// Why not.
        source: Box<crate::import::ImportError>,
    },
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
    /// Writing USD.
    #[error(transparent)]
    Usd(#[from] WriteUsdError),
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
            Self::NoCameras => Category::BadInput,
            Self::ReadBack { .. } => Category::Internal,
            Self::Fourdgs(e) => e.kind().into(),
            Self::Ply(e) => e.kind().into(),
            Self::Splatv(e) => e.kind().into(),
            Self::Spz(e) => e.kind().into(),
            Self::Gltf(e) => e.kind().into(),
            Self::Usd(e) => e.kind().into(),
            Self::Colmap(e) => e.kind().into(),
            Self::Nerfstudio(e) => e.kind().into(),
        }
    }
}
