//! Initial motion: moves the dynamic points of a keyframe to the next one
//! (docs/spec/optimiser.md 2.6).
//!
//! ```text
//! register (two keyframes -> a rigid motion around each point) -> field (motion at any place)
//! KeyframeTracks (shifts of the tracks of the capture)
//! pieces, align (brought onto what a frame shows, by colour and depth), window (nodes over a span of time)
//! ```

mod align;
mod deviation;
mod field;
mod observed;
mod pieces;
mod register;
mod rigid;
mod smooth;
mod window;

pub(crate) use deviation::UNIT_WIDTH;
pub(crate) use field::{Field, Fields, Paths, fields};
pub(crate) use observed::Observed;
pub(crate) use register::{KeyframeTracks, KeyframeView, NODE_PIXELS, REACH_PIXELS};
pub(crate) use rigid::Rigid;
pub(crate) use window::WindowMotion;
