//! Poses, focal length, depth and motion masks from the frames of a video, without weights.
//!
//! ```text
//! frames -> sparse (tracks, poses, focal, points) -> dense (motion masks, depth) -> capture
//! frames, dense correspondences -> tracker (graph, dba) -> poses, focal length, depth, static map
//! ```
//!
//! The second line is the geometric core of MegaSaM: it needs a source of correspondences that finds where the pixels of one frame are
//! seen in another, behind [`tracker::Correspondence`]: optical flow, or a network. [`megasam`] goes all the way with it, from
//! images to consistent depth.
//!
//! [`instances`] splits dynamic regions of any source into objects, segments them and tracks them through the clip.
//! [`tracks3d`] tracks dynamic points through a clip whose cameras and depth are known, visible or occluded.
//!
//! `sparse` and `dense` meet in the types of [`reconstruction`] alone, so either can be replaced.
#![forbid(unsafe_code)]

pub mod consistency;
pub mod cvd;
pub mod dba;
pub mod dense;
pub mod graph;
pub mod instances;
pub mod megasam;
#[cfg(test)]
mod published;
pub mod reconstruction;
pub mod sparse;
pub mod tracker;
pub mod tracks3d;
