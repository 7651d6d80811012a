//! The front end: the methods for cameras, optical flow and monocular depth, with or without
//! networks, in any combination.
//!
//! ```text
//! --frontend WORD+WORD --parse--> Frontend --plan: which weights are here--> Plan
//!   Plan --load--> MeasureFlow, MonoDepth    (cameras from tracked corners: classical.rs)
//!              --> tracking network, PairFlow, DepthPrior    (megasam.rs)
//! ```

mod depth;
mod flow;
mod plan;
#[cfg(feature = "nets")]
mod tracking;

pub(super) use plan::{Plan, plan};
#[cfg(feature = "nets")]
pub(super) use tracking::NetworkCorrespondence;
