//! The integration tests of this crate, in one program.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod bad_inputs;
mod batch;
mod common;
mod density;
mod enhance;
mod faults;
mod features;
mod floor;
mod geometry;
#[cfg(unix)]
mod hostile;
mod import;
mod interchange;
mod networks;
mod outputs;
mod pipeline;
mod render;
mod reproduce;
mod view;
