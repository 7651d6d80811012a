//! Errors of reading and writing images.

use crate::ErrorKind;
use crate::shortened;
use std::io;
use std::path::PathBuf;

/// Why an image could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadImageError {
    /// The file could not be opened or read.
    #[error("cannot read the image {}: {source}", shortened(path.display()))]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The file is not a PNG or JPEG file.
    #[error("{} is not a PNG or JPEG image; convert it to one of these", shortened(path.display()))]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
    /// The bytes are not an image.
    #[error("the image {} is damaged ({reason}); export it again", shortened(path.display()), reason = shortened(reason))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Message of the decoder.
        reason: String,
    },
    /// The image claims to be larger than the limit.
    #[error("the image {} is {width} x {height} pixels, above the limit of {limit} pixels per side; resize it", shortened(path.display()))]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Longest side that is read.
        limit: u32,
    },
    /// A depth map that is not a 16-bit greyscale PNG.
    #[error("the depth map {} is {found}; it must be a greyscale PNG with 16 bits per pixel", shortened(path.display()), found = shortened(found))]
    NotDepth {
        /// The file.
        path: PathBuf,
        /// What the file holds.
        found: String,
    },
    /// A map of things that is not a greyscale PNG.
    #[error("the instance map {} is {found}; it must be a greyscale PNG with 8 or 16 bits per pixel, 0 where there is none", shortened(path.display()), found = shortened(found))]
    NotIds {
        /// The file.
        path: PathBuf,
        /// What the file holds.
        found: String,
    },
}

impl ReadImageError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { source, .. } => ErrorKind::of_read(source),
            Self::UnknownFormat { .. } => ErrorKind::Unsupported,
            Self::Damaged { .. } | Self::TooLarge { .. } | Self::NotDepth { .. } | Self::NotIds { .. } => {
                ErrorKind::BadData
            }
        }
    }
}

/// Why an image could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteImageError {
    /// The file system refused.
    #[error("cannot write the image {}: {source}; check the folder's permissions and free space", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The extension names a format that is not written.
    #[error("cannot write {}: the name must end in .png, .jpg or .jpeg", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
    /// The image cannot be stored in that format.
    #[error("cannot encode the image {}: {reason}", path.display())]
    Encode {
        /// The file.
        path: PathBuf,
        /// Message of the encoder.
        reason: String,
    },
}

impl WriteImageError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { .. } => ErrorKind::CannotWrite,
            Self::UnknownFormat { .. } => ErrorKind::Unsupported,
            Self::Encode { .. } => ErrorKind::BadData,
        }
    }
}
