//! Why an import failed.

use crate::Category;
use m4_formats::fourdgs::ReadFourdgsError;
use m4_formats::gltf::ReadGltfError;
use m4_formats::ply::ReadPlyError;
use m4_formats::splatv::ReadSplatvError;
use m4_formats::spz::ReadSpzError;
use m4_formats::usd::ReadUsdError;
use m4_io::megasam::{MegasamFault, ReadMegasamError};
use std::path::PathBuf;

/// Why an import failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// A file whose name says nothing.
    #[error("the name of {} does not say what it is; add --format, one of {known}", path.display())]
    Unknown {
        /// The file.
        path: PathBuf,
        /// The formats that can be imported.
        known: String,
    },
    /// A format that is written only.
    #[error("{name} files cannot be imported; {known} can")]
    WriteOnly {
        /// The format.
        name: &'static str,
        /// The formats that can be imported.
        known: String,
    },
    /// A folder.
    #[error("{} is a folder: a sequence cannot be imported as a clip, since nothing says which splat of one file is which of the next; give one of its files{}", path.display(), example(first))]
    Sequence {
        /// The folder.
        path: PathBuf,
        /// A file in it.
        first: Option<PathBuf>,
    },
    /// A file without splats.
    #[error("{} holds no splats, so there is nothing to see", path.display())]
    NoSplats {
        /// The file.
        path: PathBuf,
    },
    /// An option of captures for a file of splats.
    #[error("{option} has no meaning for {format} files, which hold splats; leave it out")]
    NoCaptureOption {
        /// The option.
        option: &'static str,
        /// The format.
        format: &'static str,
    },
    /// Reading files of MegaSaM.
    #[error(transparent)]
    Megasam(#[from] ReadMegasamError),
    /// Reading `.4dgs`.
    #[error(transparent)]
    Fourdgs(#[from] ReadFourdgsError),
    /// Reading PLY.
    #[error(transparent)]
    Ply(#[from] ReadPlyError),
    /// Reading `.splatv`.
    #[error(transparent)]
    Splatv(#[from] ReadSplatvError),
    /// Reading SPZ.
    #[error(transparent)]
    Spz(#[from] ReadSpzError),
    /// Reading glTF.
    #[error(transparent)]
    Gltf(#[from] ReadGltfError),
    /// Reading back USD.
    #[error(transparent)]
    Usd(#[from] ReadUsdError),
}

fn example(first: &Option<PathBuf>) -> String {
    first
        .as_ref()
        .map_or_else(String::new, |f| format!(", such as {}", f.display()))
}

impl ImportError {
    /// What sort of failure this is.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::Unknown { .. } | Self::WriteOnly { .. } | Self::NoCaptureOption { .. } => Category::Usage,
            Self::Megasam(ReadMegasamError {
                fault: MegasamFault::Option { .. },
                ..
            }) => Category::Usage,
            Self::Megasam(e) => e.kind().into(),
            Self::Sequence { .. } | Self::NoSplats { .. } => Category::BadInput,
            Self::Fourdgs(e) => e.kind().into(),
            Self::Ply(e) => e.kind().into(),
            Self::Splatv(e) => e.kind().into(),
            Self::Spz(e) => e.kind().into(),
            Self::Gltf(e) => e.kind().into(),
            Self::Usd(e) => e.kind().into(),
        }
    }
}
