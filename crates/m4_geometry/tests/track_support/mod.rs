//! Boxes followed, and how far the tracks are from the truth.

pub mod score;
mod true_flow;

pub use score::{clip, score};
pub use true_flow::TrueFlow;
