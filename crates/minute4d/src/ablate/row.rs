//! The rows of an ablation.

use crate::settings::Enhancement;
use serde::{Deserialize, Serialize};

/// One row: everything, or everything but a part (paper, table 3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Row {
    /// Everything. Always there: the others are compared with it.
    Full,
    /// Masks are what motion and colours say.
    NoSeg,
    /// No points are followed or carried from one frame to another.
    NoTrack,
    /// Splats are neither added nor pruned.
    NoDensity,
}

impl Row {
    /// In the order of tables.
    pub const ALL: [Self; 4] = [Self::Full, Self::NoSeg, Self::NoTrack, Self::NoDensity];

    /// As options and folders call it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::NoSeg => "no-seg",
            Self::NoTrack => "no-track",
            Self::NoDensity => "no-density",
        }
    }

    /// Returns the name in tables.
    #[must_use]
    pub fn title(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::NoSeg => "without segmentation",
            Self::NoTrack => "without tracking",
            Self::NoDensity => "without density control",
        }
    }

    /// What it goes without.
    #[must_use]
    pub fn without(self) -> Option<Enhancement> {
        match self {
            Self::Full => None,
            Self::NoSeg => Some(Enhancement::Segmentation),
            Self::NoTrack => Some(Enhancement::Tracking),
            Self::NoDensity => Some(Enhancement::Density),
        }
    }
}

/// No row of that name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no row {0:?}; the rows are full, no-seg, no-track and no-density")]
pub struct UnknownRow(pub String);

impl std::str::FromStr for Row {
    type Err = UnknownRow;

    fn from_str(text: &str) -> Result<Self, UnknownRow> {
        let found = Self::ALL.into_iter().find(|row| row.name() == text);
        found.ok_or_else(|| UnknownRow(text.to_owned()))
    }
}
