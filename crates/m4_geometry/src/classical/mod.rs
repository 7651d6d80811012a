//! The classical front end: geometry without weights.
//!
//! ```text
//! frames -> sparse (feature tracks, structure from motion) -> dense (flow, plane sweep, motion segmentation) -> depth and masks
//! ```
//!
//! `sparse` and `dense` meet in the types of [`reconstruction`] alone, so either can be replaced.

pub mod dense;
pub mod reconstruction;
pub mod sparse;
