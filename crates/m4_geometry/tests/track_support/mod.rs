//! Boxes followed, and how far the tracks are from the truth.

mod dense_flow;
pub mod score;
mod true_flow;

pub use dense_flow::{DenseFlow, FlowCorrespondence};
pub use score::{clip, score};
pub use true_flow::TrueFlow;
