//! Which frames of a capture, and how much memory they may take.

use crate::reach::Reach;
use serde::{Deserialize, Serialize};

/// The two lists of frames that a capture has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// The training video.
    Train,
    /// Held-out views, for scoring alone.
    Test,
}

impl Split {
    /// The JSON file that lists the frames.
    #[must_use]
    pub fn file_name(self) -> &'static str {
        match self {
            Self::Train => "transforms_train.json",
            Self::Test => "transforms_test.json",
        }
    }

    /// The file of tracks that is written.
    pub(super) fn tracks_file(self) -> &'static str {
        match self {
            Self::Train => super::TRACKS_FILE,
            Self::Test => "test_tracks.npz",
        }
    }

    /// Folders of the images, depth maps, masks, maps of motion and maps of instances that are written.
    #[must_use]
    pub fn folders(self) -> [&'static str; 5] {
        match self {
            Self::Train => ["train", "depth", "mask", "motion", "instance"],
            Self::Test => ["test", "test_depth", "test_mask", "test_motion", "test_instance"],
        }
    }
}

/// What [`super::read()`] may take and read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CaptureOptions {
    /// Bytes that the decoded frames (about 5 per pixel: colour, depth and mask) may take before reading is
    /// refused, and each array of the tracks. Default 4 GiB: half of the memory of a small laptop.
    pub max_memory_bytes: u64,
    /// Which files the list of frames may name. Not a setting: only the command line can allow more.
    #[serde(skip)]
    pub reach: Reach,
}

impl Default for CaptureOptions {
    fn default() -> Self {
        Self {
            max_memory_bytes: 4 << 30,
            reach: Reach::Inside,
        }
    }
}
