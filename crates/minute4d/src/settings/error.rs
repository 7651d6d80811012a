//! Errors of settings.

use super::Profile;
use crate::Category;
use m4_io::{ErrorKind, shortened};
use std::path::PathBuf;

/// Why settings could not be put together.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SettingsError {
    /// The file could not be read.
    #[error("cannot read the settings {}", path.display())]
    Read {
        /// The file given.
        path: PathBuf,
        /// Message of the system.
        source: std::io::Error,
    },
    /// The file is not TOML.
    #[error("{} is not valid TOML: {}", path.display(), shortened(reason))]
    Syntax {
        /// The file given.
        path: PathBuf,
        /// Line, column and what was expected there.
        reason: String,
    },
    /// A `--set` without `=`, or with an empty key.
    #[error("--set {given:?} is not of the form key=value, such as train.iterations=2000")]
    Form {
        /// The argument.
        given: String,
    },
    /// A key that no setting has.
    #[error("{layer}: there is no setting {:?}{}; known here: {}", shortened(key), suggest(suggestion), known.join(", "))]
    UnknownKey {
        /// The file or argument.
        layer: String,
        /// The whole key, dotted.
        key: String,
        /// The nearest known key, dotted.
        suggestion: Option<String>,
        /// The keys known at that place.
        known: Vec<String>,
    },
    /// A value of the wrong type or out of range.
    #[error(
        "{layer}: {} = {} does not work: {}",
        shortened(key),
        shortened(value),
        shortened(reason)
    )]
    BadValue {
        /// The file or argument.
        layer: String,
        /// The whole key, dotted.
        key: String,
        /// The value given.
        value: String,
        /// What would work.
        reason: String,
    },
    /// The layers were written for the other profile.
    #[error(
        "the settings file or --set names profile = {:?}, and {:?} was asked for; leave one of them out",
        named.name(),
        asked.name()
    )]
    OtherProfile {
        /// The profile that the layers name.
        named: Profile,
        /// The profile of the settings under them.
        asked: Profile,
    },
    /// The built-in settings cannot be written as TOML, a bug of ours.
    #[error("the built-in settings cannot be written as TOML: {reason}")]
    Internal {
        /// Message of the serialiser.
        reason: String,
    },
}

impl SettingsError {
    /// Returns the category of the failure.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::Read { source, .. } => ErrorKind::of_read(source).into(),
            Self::Internal { .. } => Category::Internal,
            _ => Category::BadSettings,
        }
    }
}

fn suggest(nearest: &Option<String>) -> String {
    nearest
        .as_ref()
        .map_or_else(String::new, |key| format!("; did you mean {key:?}?"))
}
