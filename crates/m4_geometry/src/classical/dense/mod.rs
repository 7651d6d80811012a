//! Depth a pixel and motion masks, given cameras and tracks: classical, without weights.
//!
//! ```text
//! frames -> working size -> flow to the neighbours ----------------------.
//!              |                                                          v
//!              '-> plane sweep -> consistency -> static depth -> motion evidence -> masks
//!                                                     ^                              |
//!                                                     '------- once more ------------|
//!                                                                                    v
//!                           static depth over wide baselines: refined on brightness, merged over the frames, filled by planes
//!                                                                                    |
//!                                                                                    v
//!                                                             outlines of the masks: what differs from the background behind them
//!                                                                                    |
//!                                                                                    v
//!                                         depth of the dynamic parts (without parallax: layers) -> full size
//!                                                     '-> tracks along the flow ([`crate::tracks`])
//! ```
//!
//! What measures flow, what outlines the parts of the masks and what knows depth from one image, if
//! anything does, is the caller's choice ([`Sources`]). Depth from one image ([`MonoDepth`]) is
//! aligned to what is measured, and stands where nothing was measured or something moves.
//!
//! Everything happens at a working size ([`DenseConfig::working_side_px`]) and is brought to the
//! size of the frames at the end, along the edges of the frames. Inside, depth is *disparity*, one
//! over z-depth, in which both the noise of a stereo measurement and a plane are simple.
//!
//! Follows docs/spec/front-end.md 7.1: inverse search flow (Kroeger et al. 2016), plane sweep
//! (Collins 1996) with census cost (Zabih and Woodfill 1994), semi-global aggregation
//! (Hirschmueller 2008), fast global smoothing (Min et al. 2014), and visibility-based fusion
//! (Merrell et al. 2007).

mod background_model;
mod estimate;
mod fusion;
mod layers;
mod mono;
mod motion;
mod motion_segmentation;
mod moving_depth;
mod refine;
mod regions;
mod rigid_objects;
mod segment;
mod shot;
mod sources;
mod static_depth;
mod sweep;
mod temporal;
mod tracks;
mod trajectories;
mod working;

pub use estimate::{Dense, DenseFrame, Estimate, estimate};
pub use mono::{MonoDepth, MonoKind};
pub(crate) use regions::{Components, to_outside};
pub use rigid_objects::{DistanceCue, DynamicObject, distance_sigma};
pub(crate) use segment::{
    LEAST_OVERLAP, LEAST_PART_PX, LEAST_QUALITY, asked, belief, box_of, points_apart, prompt,
};
pub use segment::{SegmentMask, SegmentPrompt, Segmenter};
pub use sources::{DenseConfig, DenseError, MeasureFlow, SourceError, Sources};
