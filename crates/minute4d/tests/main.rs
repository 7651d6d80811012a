//! The integration tests of this crate, in one program.

mod layers;
mod lifetimes;
mod viewer_quality;
