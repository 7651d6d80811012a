//! The seam between dense geometry and whatever knows depth from one image: a sensor, a network, nothing.
//!
//! ```text
//! MonoDepth (source) --> a plane of disparities per frame, NaN where unknown (working)
//!    metric: taken as it is, and as what was measured
//!    else:   aligned to what stereo over time measured (align) --> where nothing was measured, and where something moves
//! ```

mod align;
mod source;
mod working;

#[cfg(test)]
mod tests;

pub use source::{MonoDepth, MonoError, MonoKind, MonoMap, NoDepth, SensorDepth};
pub(super) use working::Mono;
