//! The integration tests of this crate, in one program.

mod image_metrics;
mod trajectory;
