//! Why scores could not be computed.

use m4_eval::geometry::GeometryError;
use m4_eval::image::ImageError;
use m4_io::{ReadError, WriteError};
use m4_kernels::SimdLevelError;
use m4_train::init::InitError;
use minute4d::settings::SettingsError;
use minute4d::{Category, OutputError, Refusal};

/// Why scores could not be computed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Reading, drawing or writing.
    #[error(transparent)]
    Minute4d(minute4d::Error),
    /// Scoring images.
    #[error(transparent)]
    Score(#[from] ImageError),
    /// Scoring geometry.
    #[error(transparent)]
    ScoreGeometry(#[from] GeometryError),
}

/// Lets `?` turn errors of the library and its parts into [`Error`].
macro_rules! from_library {
    ($($part:ty),+) => {
        $(
            impl From<$part> for Error {
                fn from(error: $part) -> Self {
                    Self::Minute4d(error.into())
                }
            }
        )+
    };
}

from_library!(
    minute4d::Error,
    InitError,
    OutputError,
    ReadError,
    Refusal,
    SettingsError,
    SimdLevelError,
    WriteError
);

#[cfg(feature = "nets")]
from_library!(minute4d::weights::WeightsError);

impl Error {
    /// Returns the category of the failure.
    pub fn category(&self) -> Category {
        match self {
            Self::Minute4d(error) => error.category(),
            Self::Score(_) | Self::ScoreGeometry(_) => Category::BadInput,
        }
    }

    /// True when the caller asked to stop.
    pub fn is_stop(&self) -> bool {
        self.category() == Category::Stopped
    }
}
