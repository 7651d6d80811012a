//! Masks against what a picture shows: a segmenter is asked, part by part, what the coarse mask means.
//!
//! ```text
//! coarse mask --parts--> prompt (box, points, belief) --Segmenter--> mask, quality --plausible?--> sharp mask
//! ```
//!
//! Motion finds what moves but not its outline: flow is smooth across edges, a plate is of the colours of its neighbours, and what lies
//! still between two legs looks like the legs. A network that knows what things look like has the outline but does not know
//! what moves. Prompts as in Kirillov et al., "Segment Anything" (2023): a box, points and the logits of an earlier mask.

mod config;
mod distance;
mod prompt;
mod refine;
mod source;

pub use config::SegmentConfig;
pub(crate) use distance::to_outside;
pub(crate) use prompt::{belief, points_apart};
pub(super) use refine::sharpen;
pub use source::{SegmentError, SegmentMask, SegmentPrompt, Segmenter};
