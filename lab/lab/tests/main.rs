//! The integration tests of the laboratory, in one program.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod ablate;
mod bench;
#[expect(dead_code, reason = "some helpers are for the tests of minute4d alone")]
#[path = "../../../apps/minute4d/tests/common/mod.rs"]
mod common;
mod floor;
mod geometry;
mod reproduce;

use std::process::Command;

/// The program that runs a command: the laboratory, which also has the commands of `minute4d`.
fn program(command: &str) -> Command {
    let mut lab = Command::new(env!("CARGO_BIN_EXE_minute4d-lab"));
    if !["ablate", "bench", "eval-geometry", "reproduce"].contains(&command) {
        lab.arg("minute4d");
    }
    lab
}
