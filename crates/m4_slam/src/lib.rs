//! Poses, focal length, depth and motion masks from the frames of a video, without weights.
//!
//! ```text
//! frames -> sparse (tracks, poses, focal, points) -> dense (motion masks, depth) -> capture
//! ```
//!
//! `sparse` and `dense` meet in the types of [`reconstruction`] alone, so either can be replaced.
#![forbid(unsafe_code)]

pub mod cvd;
pub mod dba;
pub mod dense;
pub mod graph;
pub mod reconstruction;
pub mod sparse;
pub mod tracker;
