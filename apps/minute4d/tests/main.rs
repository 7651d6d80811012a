//! The integration tests of this crate, in one program.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod bad_inputs;
mod batch;
mod common;
mod density;
mod enhance;
mod examples;
mod faults;
mod features;
mod footage;
mod gallery;
mod geometry;
#[cfg(unix)]
mod hostile;
mod import;
mod interchange;
mod networks;
mod outputs;
mod pipeline;
mod protocols;
mod python;
mod render;
mod view;

/// The program that runs a command.
fn program(_: &str) -> std::process::Command {
    std::process::Command::new(env!("CARGO_BIN_EXE_minute4d"))
}
