//! Errors of rendering along a camera path.

use crate::Category;
use std::path::PathBuf;

/// Why a camera path cannot be rendered.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PathError {
    /// An option of another path.
    #[error("{option} has no meaning for the camera path {path}; it takes {}", takes(known))]
    Unused {
        /// The option, as the program calls it.
        option: &'static str,
        /// The path.
        path: String,
        /// The options of the path.
        known: &'static [&'static str],
    },
    /// A number that cannot work.
    #[error("{option} is {value}; {expected} was expected")]
    Range {
        /// The option.
        option: &'static str,
        /// The value.
        value: f64,
        /// The allowed values.
        expected: &'static str,
    },
    /// More images than anyone wants.
    #[error(
        "the path takes {seconds} s, which is {frames} images at {fps} per second; at most {limit} are rendered, so choose fewer with --seconds or --fps"
    )]
    TooManyFrames {
        /// Length, seconds.
        seconds: f64,
        /// Images a second.
        fps: f64,
        /// Images.
        frames: f64,
        /// Most images.
        limit: usize,
    },
    /// A bullet path that is over before time is frozen.
    #[error(
        "--seconds {seconds} leaves no time besides the {hold_s} s for which time is frozen; choose more, or less with --hold-s"
    )]
    TooShort {
        /// Length asked for.
        seconds: f64,
        /// Length of the frozen part and of the ways into and out of it.
        hold_s: f64,
    },
    /// A scene without its cameras.
    #[error(
        "the scene has no cameras of its source, so there is no camera path {path}; give a file of cameras with --path"
    )]
    NoSource {
        /// The path.
        path: String,
    },
    /// Neither a path nor a file.
    #[error("there is no camera path {name:?}; write {}, or the name of a file", super::path::WORDS.join(", "))]
    Unknown {
        /// The given value.
        name: String,
    },
    /// Many images into one file.
    #[error("{} is one image, but the path has {frames}; name a folder or an .mp4 file, or choose one time with --path source --at T", path.display())]
    OneImage {
        /// The file.
        path: PathBuf,
        /// Images of the path.
        frames: usize,
    },
    /// A name that promises another sort of video.
    #[error("{} has the extension {extension}, which is not supported; name an .mp4 file, a .png file or a folder", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// Its extension.
        extension: String,
    },
    /// An image too small or too large.
    #[error("images of {width} x {height} pixels are not supported; each side must have 1 to {limit}")]
    Size {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Longest side.
        limit: usize,
    },
}

impl PathError {
    /// Returns the category of the failure.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::NoSource { .. } => Category::BadInput,
            _ => Category::Usage,
        }
    }
}

fn takes(known: &[&str]) -> String {
    if known.is_empty() {
        "none of these options".to_owned()
    } else {
        known.join(", ")
    }
}
