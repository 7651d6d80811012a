//! Depth a pixel and motion masks, given cameras and tracks: classical, without weights.
//!
//! ```text
//! frames -> working size -> flow to the neighbours ----------------------.
//!              |                                                          v
//!              '-> plane sweep -> consistency -> static depth -> motion evidence -> masks
//!                                                     ^                              |
//!                                                     '------- once more ------------|
//!                                                                                    v
//!                                           depth of the moving parts (without parallax: layers) -> full size
//!                                                     '-> tracks along the flow ([`crate::tracks`])
//! ```
//!
//! What measures flow, what outlines the parts of the masks and what knows depth from one image, if anything does, is the
//! caller's choice ([`Sources`]). Depth from one image (`MonoDepth`: a sensor, later a network) replaces what is measured
//! where it is metric; else it is aligned to that, and stands where nothing was measured or something moves.
//!
//! Everything happens at a working size ([`DenseConfig::working_side_px`]) and is brought to the size
//! of the frames at the end, along the edges of the frames. Inside, depth is *disparity*, one over
//! z-depth, in which both the noise of a stereo measurement and a plane are simple.
//!
//! Follows docs/spec/front-end.md 7.1: inverse search flow (Kroeger et al. 2016),
//! plane sweep (Collins 1996) with census cost (Zabih and Woodfill 1994), semi-global aggregation
//! (Hirschmueller 2008), and fast global smoothing (Min et al. 2014).

mod background_model;
mod estimate;
mod flow;
mod layers;
mod mono;
mod motion;
mod motion_segmentation;
mod moving_depth;
mod regions;
mod rigid_objects;
mod segment;
mod shot;
mod smooth;
mod sources;
mod static_depth;
mod sweep;
mod tracks;
mod working;

pub use estimate::{Dense, DenseFrame, Estimate, estimate};
pub use flow::{FlowError, FlowImage, FlowSource, InverseSearch};
pub(crate) use flow::{FlowPair, ScaledFrame, round_trip_px};
pub use mono::{MonoDepth, MonoError, MonoKind, MonoMap, NoDepth, SensorDepth};
pub(crate) use regions::{Components, to_outside};
pub(crate) use segment::{
    LEAST_OVERLAP, LEAST_PART_PX, LEAST_QUALITY, belief, box_of, checked_masks, points_apart, prompt,
};
pub use segment::{SegmentError, SegmentMask, SegmentPrompt, Segmenter};
pub(crate) use smooth::Smoother;
pub use sources::{DenseConfig, DenseError, Sources};
pub(crate) use working::working_size;
