//! Masks against what an image shows: a segmenter is asked, part by part, what the coarse mask means.
//!
//! ```text
//! coarse mask --parts--> prompt (box, points, belief) --Segmenter--> mask, quality --plausible?--> sharp mask
//! ```
//!
//! Motion finds dynamic regions but not their outline: flow is smooth across edges, a background model has the colours of the neighbours, and what lies
//! still between two legs looks like the legs. A network that knows what things look like has the outline but does not know
//! what moves. Prompts as in Kirillov et al., "Segment Anything" (2023): a box, points and the logits of an earlier mask.
//! What prompts contain and which answers are taken was measured with MobileSAM: docs/geometry.md.

mod distance;
mod prompt;
mod refine;
mod source;

pub(crate) use distance::to_outside;
pub(crate) use prompt::{belief, points_apart};
pub(super) use refine::sharpen;
pub use source::{SegmentError, SegmentMask, SegmentPrompt, Segmenter};

/// Parts of fewer pixels at the working size are left as they are.
pub(crate) const LEAST_PART_PX: usize = 60;
/// Points on a part: the deepest, and others far from it and from each other.
pub(crate) const POINTS: usize = 3;
/// How fast belief grows with the distance from the edge of a part, logits per pixel.
pub(crate) const BELIEF_PER_PX: f32 = 1.0;
/// The firmest belief, logits: more holds the answer closer to the coarse mask.
pub(crate) const BELIEF_LIMIT: f32 = 4.0;
/// Least quality that the segmenter expects of a mask that is taken (intersection over union).
pub(crate) const LEAST_QUALITY: f32 = 0.7;
/// Least intersection over union with the part of a mask that is taken: a far larger or smaller mask is another thing.
pub(crate) const LEAST_OVERLAP: f32 = 0.6;
