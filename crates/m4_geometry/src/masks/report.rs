//! What was found, for people and records.

use super::polarity::PolarityEvidence;
use serde::{Deserialize, Serialize};

/// How the way of a thing ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "how")]
pub enum Ending {
    /// It is seen to the last frame.
    ClipEnd,
    /// It was lost: it left, something hid it, or it could not be told from what is around it any more.
    Lost {
        /// The first frame without it.
        frame: usize,
    },
    /// It went out of sight and was still waited for when the clip ended.
    Unseen {
        /// The first frame without it.
        frame: usize,
    },
}

/// One thing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InstanceRecord {
    /// Its number in the maps.
    pub id: u16,
    /// The first frame that shows it.
    pub first_frame: usize,
    /// The last frame that shows it.
    pub last_frame: usize,
    /// How many frames show it.
    pub frames: usize,
    /// Share of the image that it covers, mean over the frames that show it.
    pub mean_area_share: f64,
    /// The same, the largest.
    pub max_area_share: f64,
    /// The frame in which it was found.
    pub prompted_frame: usize,
    /// Intersection over union of the segmenter's mask there with the coarse part.
    pub prompt_overlap: f32,
    /// How far the segmenter trusted its mask there.
    pub prompt_quality: Option<f32>,
    /// True if it started with the outline of the coarse part, because the segmenter's differed too much.
    pub coarse_outline: bool,
    /// Share of its frames in which coarse pixels support it.
    pub supported_share: f64,
    /// Frames in which its mask had become background and was not taken.
    pub overgrown_frames: usize,
    /// How it ends.
    pub ending: Ending,
    /// Frames in which it was found again as another thing, which it turned out to be.
    pub found_again: Vec<usize>,
}

/// Why a coarse part did not become a thing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "why")]
pub enum Rejection {
    /// It is there for a moment only.
    Flicker {
        /// In how many of three frames it is seen.
        seen_in: usize,
    },
    /// The segmenter sees nothing.
    Nothing,
    /// The mask covers too much of the image: background.
    TooLarge {
        /// Share of the image.
        share: f32,
    },
    /// The mask is of something else.
    Elsewhere {
        /// Intersection over union with the part.
        overlap: f32,
    },
    /// The mask is that of a thing that is there already.
    Duplicate {
        /// Its number; `None` if that was dropped later.
        of: Option<u16>,
    },
    /// Followed over its frames, it hardly ever moves.
    Unsupported {
        /// Share of its frames in which coarse pixels support it.
        share: f64,
    },
    /// There are more things than numbers.
    TooMany,
}

/// A coarse part that did not become a thing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Rejected {
    /// The frame in which it was asked about.
    pub frame: usize,
    /// Share of the image that it covers.
    pub area_share: f64,
    /// Column and row of its middle, pixels of the working size.
    pub centre_px: [f32; 2],
    /// Why.
    #[serde(flatten)]
    pub reason: Rejection,
}

/// What refinement found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InstanceReport {
    /// Tracking method.
    pub segmenter: String,
    /// Where the coarse masks come from: `motion` or `masks`.
    pub coarse: String,
    /// What speaks for and against the reading of maps of motion.
    pub polarity: Option<PolarityEvidence>,
    /// Frames of the clip.
    pub frames: usize,
    /// Width and height at which things were followed.
    pub size: [usize; 2],
    /// Frames from one search for new things to the next.
    pub every_frames: usize,
    /// Share of all pixels that the coarse masks cover.
    pub coarse_share: f64,
    /// Share of all pixels that the refined masks cover.
    pub refined_share: f64,
    /// Share of all pixels that are in the masks without belonging to a thing.
    pub unexplained_share: f64,
    /// The things, by number.
    pub instances: Vec<InstanceRecord>,
    /// Parts that did not become things, by frame.
    pub rejected: Vec<Rejected>,
}
