//! Initial motion: moves the dynamic points of a keyframe to the next one (docs/spec/optimiser.md 2.6).
//!
//! ```text
//! register (two keyframes -> a rigid motion around each point) -> field (motion at any place)
//! KeyframeTracks (shifts of the tracks of the capture), patches (Lucas-Kanade between their images)
//! bodies (points that hang together move together, visible or not)
//! ```

mod field;
mod patches;
mod register;
mod rigid;

pub(crate) use field::{Field, Fields, Paths, fields};
pub(crate) use register::{KeyframeTracks, NODE_PIXELS, REACH_PIXELS, View};
#[cfg(test)]
pub(crate) use rigid::Rigid;
pub(crate) use rigid::bodies;
