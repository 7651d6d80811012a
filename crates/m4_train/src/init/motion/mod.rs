//! Initial motion: moves the dynamic points of a keyframe to the next one (docs/spec/optimiser.md 2.6).
//!
//! ```text
//! register (two keyframes -> a rigid motion around each point) -> field (motion at any place)
//! follow (what tracks of the capture say, where there are any)
//! look (their images -> where patches went)
//! bodies (what hangs together moves together, seen or not)
//! ```

mod bodies;
mod field;
mod follow;
mod look;
mod register;
mod rigid;

pub(crate) use bodies::bodies;
pub(crate) use field::{Field, Fields, fields};
pub(crate) use follow::Ways;
pub(crate) use register::{NODE_PIXELS, REACH_PIXELS, Registration, View};
#[cfg(test)]
pub(crate) use rigid::Rigid;
