//! Masks over time: things that move are found in coarse masks, outlined once, and followed through the clip.
//!
//! ```text
//! motion probability > tau, or masks --open, parts--> coarse parts
//!   frame 0: part --points, box--> VideoSession::prompt --guards--> object
//!   follow to frame B, 2B, ...: what the objects do not cover and what persists --> new objects
//!   follow the new ones backwards --> masks of every object --> numbers a pixel, union, report
//! ```
//!
//! Motion gives rough dynamic regions per frame; a segmentation network refines their outlines and
//! where they are in other frames ([`VideoSegmenter`]): a network with a memory, or [`FlowFollower`], which carries masks along optical flow
//! and asks a segmenter of single images, if there is one, what they mean there.
//!
//! Source: the segmentation-tracking enhancement of Minute4D (docs/spec/front-end.md 2.4: threshold 0.7, prompts
//! from parts, guards, new prompts every B frames, both ways); prompts as in Kirillov et al., "Segment Anything" (2023), the state
//! machine as in Ravi et al., "SAM 2: Segment Anything in Images and Videos" (2024).
//!
//! **Conventions.** Masks are of one working size for the clip, which has the shape of its frames. Places are in pixels of that size; the centre
//! of the first pixel is (0.5, 0.5). Frames count from 0, numbers of instances from 1.

mod coarse;
mod finish;
mod follow;
mod ledger;
mod polarity;
mod propose;
mod refine;
mod report;
mod settings;
mod source;

#[cfg(test)]
mod tests;

pub use coarse::Coarse;
pub use follow::FlowFollower;
pub use polarity::{Polarity, PolarityEvidence};
pub use refine::{RefineInput, Refined, RefinedFrame, refine};
pub use report::{Ending, InstanceRecord, InstanceReport, Rejected, Rejection};
pub use settings::{InstanceError, RefineSettings};
pub use source::{
    FrameSource, ImageError, ImageList, ObjectId, ObjectMask, ObjectPrompt, VideoError, VideoSegmenter, VideoSession,
    Visibility,
};
