//! Errors of a reproduction.

use super::{MissingScene, Suite};
use crate::Category;
use crate::evaluate::Protocol;
use m4_io::ReadError;
use std::path::{Path, PathBuf};

/// Why a table cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReproduceError {
    /// No scene of the data set is there.
    #[error("no scene of {suite} is in {}: {missing}. {source_words}", path.display())]
    NoScenes {
        /// The data set.
        suite: Suite,
        /// The path that was searched.
        path: PathBuf,
        /// The missing files of each scene.
        missing: String,
        /// The source for downloading the data set.
        source_words: &'static str,
    },
    /// The data set has no test of that protocol.
    #[error("{suite} is not scored by the protocol {protocol}; its protocols are {known}")]
    NotItsProtocol {
        /// The data set.
        suite: Suite,
        /// The protocol.
        protocol: Protocol,
        /// The supported protocols.
        known: String,
    },
    /// A scene lacks its held-out views.
    #[error("{} has no held-out views, which the protocol {protocol} scores; {hint}", path.display())]
    NoViews {
        /// The scene.
        path: PathBuf,
        /// The protocol.
        protocol: Protocol,
        /// How to fix it.
        hint: &'static str,
    },
    /// Training images that are not one step of time apart each.
    #[error("the training images of {} are not evenly spaced in time, as geometry from images alone assumes; omit --geometry own", path.display())]
    UnevenTimes {
        /// The capture.
        path: PathBuf,
    },
    /// Poses of our own that lie nowhere near those of the data set.
    #[error("the cameras found from the images of {} do not align with those of the data set, so its views cannot be placed; train with --geometry given", path.display())]
    NotAligned {
        /// The scene.
        path: PathBuf,
    },
    /// A scene cannot be imported.
    #[error(transparent)]
    Import(#[from] ReadError),
    /// An image of a table cannot be written.
    #[error("cannot write {}: {what}", path.display())]
    Plot {
        /// The image.
        path: PathBuf,
        /// The message.
        what: String,
    },
}

impl ReproduceError {
    pub(super) fn no_scenes(suite: Suite, path: &Path, missing: &[MissingScene]) -> Self {
        let words: Vec<String> = missing.iter().map(|m| format!("{} ({})", m.scene, m.why)).collect();
        Self::NoScenes {
            suite,
            path: path.to_path_buf(),
            missing: words.join(", "),
            source_words: suite.source(),
        }
    }

    /// What sort of failure this is.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::NoScenes { .. } => Category::NoInput,
            Self::NotItsProtocol { .. } => Category::Usage,
            Self::NoViews { .. } | Self::UnevenTimes { .. } | Self::NotAligned { .. } => Category::BadInput,
            Self::Import(e) => e.kind().into(),
            Self::Plot { .. } => Category::CannotWrite,
        }
    }
}
