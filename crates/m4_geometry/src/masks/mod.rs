//! Masks over time: things that move are found in coarse masks, outlined once, and followed through
//! the clip.
//!
//! ```text
//! motion probability > tau, or masks --open, parts--> coarse parts
//!   frame 0: part --points, box--> VideoSession::prompt --guards--> object
//!   follow to frame B, 2B, ...: what the objects do not cover and what persists --> new objects
//!   follow the new ones backwards --> masks of every object --> numbers a pixel, union, report
//! ```
//!
//! Motion gives rough dynamic regions per frame; a segmentation network refines their outlines and
//! where they are in other frames ([`VideoSession`]): a network with a memory, or [`FlowFollower`],
//! which carries masks along optical flow and asks a segmenter of single images, if there is one,
//! what they mean there.
//!
//! Source: the segmentation-tracking enhancement of Minute4D (docs/spec/front-end.md 2.4: threshold
//! 0.7, prompts from parts, guards, new prompts every B frames, both ways); prompts as in Kirillov
//! et al., "Segment Anything" (2023), the state machine as in Ravi et al., "SAM 2: Segment Anything
//! in Images and Videos" (2024).
//!
//! **Conventions.** Masks are of one working size for the clip, which has the shape of its frames.
//! Places are in pixels of that size; the centre of the first pixel is (0.5, 0.5). Frames count
//! from 0, numbers of instances from 1.

mod coarse;
mod finish;
mod follow;
mod ledger;
mod refine;
mod source;
#[cfg(test)]
mod tests;

use crate::classical::dense::SourceError;
pub use coarse::Coarse;
use coarse::TAU_STILL;
pub use follow::FlowFollower;
pub use refine::{Refined, RefinedFrame, refine};
use serde::{Deserialize, Serialize};
pub use source::{ObjectId, ObjectMask, ObjectPrompt, VideoSession};

/// Settings of [`refine()`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefineSettings {
    /// Longest side of the masks while things are followed, pixels; frames that are smaller are
    /// used as they are. 960: the clips of the paper's data sets are not made smaller.
    pub side_px: usize,
    /// Motion above which a pixel counts as dynamic. Paper: tau = 0.7.
    pub tau: f32,
    /// Frames from one search for new things to the next. Paper: B = 50 for DyCheck, 2 for NVIDIA
    /// Dynamic, 10 for DAVIS.
    pub every_frames: usize,
}

impl Default for RefineSettings {
    fn default() -> Self {
        Self {
            side_px: 960,
            tau: 0.7,
            every_frames: 10,
        }
    }
}

impl RefineSettings {
    /// Rejects settings that no refinement could use.
    ///
    /// # Errors
    ///
    /// [`InstanceError::Setting`].
    pub fn check(&self) -> Result<(), InstanceError> {
        let need = |ok: bool, name, value: f64, range| {
            if ok {
                Ok(())
            } else {
                Err(InstanceError::Setting { name, value, range })
            }
        };
        let side = self.side_px;
        need(
            (64..=4096).contains(&side),
            "side_px",
            side as f64,
            "64 to 4096",
        )?;
        let every = self.every_frames;
        need(
            (1..=1_000_000).contains(&every),
            "every_frames",
            every as f64,
            "1 to 1000000",
        )?;
        need(
            (TAU_STILL..=1.0).contains(&self.tau),
            "tau",
            self.tau.into(),
            "0.3 to 1",
        )
    }
}

/// Why there are no refined masks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InstanceError {
    /// A clip without pixels, or coarse masks of another clip; the text says which.
    #[error("{0}")]
    Input(String),
    /// A setting out of range.
    #[error("setting {name} is {value}; it must be {range}")]
    Setting {
        /// Path of the setting.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        range: &'static str,
    },
    /// A network failed.
    #[error("{segmenter} cannot track objects in frame {frame}: {reason}")]
    Source {
        /// Its name.
        segmenter: String,
        /// The frame at which it was.
        frame: usize,
        /// What went wrong.
        reason: SourceError,
    },
    /// The user asked to stop.
    #[error("stopped on request while {phase}")]
    Cancelled {
        /// What was going on.
        phase: &'static str,
    },
}

/// Why a track ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "how")]
pub enum Ending {
    /// It is seen to the last frame.
    ClipEnd,
    /// It was lost: it left, something hid it, or it could not be told from what is around it any
    /// more.
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
    /// The frame in which it was found.
    pub prompted_frame: usize,
    /// Share of its frames in which coarse pixels support it.
    pub supported_share: f64,
    /// How it ends.
    pub ending: Ending,
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
    Duplicate,
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
