//! Errors of an import.

use crate::Category;
use m4_geometry::consistency::ConsistencyError;
use m4_io::ReadError;
use std::path::PathBuf;

/// Why an import failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// A file whose name says nothing.
    #[error("the format of {} is not recognised by its name; add --format, one of {known}", path.display())]
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
    /// A name that no format has.
    #[error("no format is called {given}; these can be imported: {known}")]
    NoSuchFormat {
        /// The given value.
        given: String,
        /// The formats that can be imported.
        known: String,
    },
    /// A folder of nothing that is known.
    #[error("{} is a folder with none of the known layouts; if it has one, select it with --format, one of {known}", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// The formats that can be imported.
        known: String,
    },
    /// A sequence of splats.
    #[error("{} is a folder: a sequence cannot be imported as a clip, since the correspondence of splats between files is unknown; give one of its files, such as {}", path.display(), first.display())]
    Sequence {
        /// The folder.
        path: PathBuf,
        /// A file in it.
        first: PathBuf,
    },
    /// A clip without poses.
    #[error("{} is a DAVIS clip, which has no camera poses; estimate them with `minute4d run IMAGES --masks ANNOTATIONS -o OUT`, with the folders of one clip", path.display())]
    NoPoses {
        /// The folder.
        path: PathBuf,
    },
    /// A file without splats.
    #[error("{} contains no splats", path.display())]
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
    /// An option that the format has no use for.
    #[error("{option} has no meaning for {format}, which has its own; leave it out")]
    NotOfFormat {
        /// The option.
        option: &'static str,
        /// The format.
        format: &'static str,
    },
    /// Reading the file or folder.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Comparing a capture with the flow of its images.
    #[error("the capture cannot be checked: {0}; --no-check imports it anyway")]
    Check(#[from] ConsistencyError),
}

impl ImportError {
    /// What sort of failure this is.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::Unknown { .. }
            | Self::WriteOnly { .. }
            | Self::NoSuchFormat { .. }
            | Self::NoCaptureOption { .. }
            | Self::NotOfFormat { .. } => Category::Usage,
            Self::Read(e) => e.kind().into(),
            Self::Folder { .. }
            | Self::Sequence { .. }
            | Self::NoPoses { .. }
            | Self::NoSplats { .. }
            | Self::Check(_) => Category::BadInput,
        }
    }
}
