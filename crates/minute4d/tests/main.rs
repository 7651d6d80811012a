//! The integration tests of this crate, in one program.

mod gpu_training;
mod layers;
mod lifetimes;
mod viewer_quality;
