//! Poses, focal length, depth and motion masks from the frames of a video, without weights.
//!
//! ```text
//! classical/     feature tracks, structure from motion, plane sweep, motion segmentation: no weights
//! megasam/       dense tracking over a graph of frames, then consistent depth (MegaSaM), for a source of correspondences
//! flow/          flow between two frames, without weights
//! dba/           dense bundle adjustment, which both use
//! masks/         segmentation and tracking of dynamic objects, for masks of any source
//! tracks/        tracks of dynamic points through a clip whose cameras and depth are known, visible or occluded
//! inspect/       shots, repeated frames, bars, overlays and exposure of a clip
//! clip_depth     depth that is known without parallax, and the unit of length
//! frame_rate     seconds in frames
//! resample       images and maps in other sizes
//! smooth         smoothing along the edges of an image
//! ```
//!
//! Networks come as functions and traits: [`megasam::tracker::Correspondence`],
//! [`classical::dense::MeasureFlow`], [`classical::dense::Segmenter`], [`masks::VideoSession`].
#![forbid(unsafe_code)]

pub mod classical;
pub mod clip_depth;
pub mod dba;
pub mod flow;
mod frame_rate;
pub mod inspect;
pub mod masks;
pub mod megasam;
#[cfg(test)]
mod published;
pub mod resample;
mod smooth;
pub mod tracks;

pub use frame_rate::FrameRate;
