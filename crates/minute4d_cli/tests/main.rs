//! The integration tests of this crate, in one program.

mod bad_inputs;
mod batch;
mod common;
mod decoder;
mod enhance;
mod faults;
mod features;
mod geometry_failures;
mod geometry_given;
mod import;
mod interchange;
mod networks;
mod pipeline;
mod playback;
mod render_paths;
mod reproduce;
mod view;
mod weights;
