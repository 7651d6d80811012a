//! The integration tests of this crate, in one program.

mod arcs;
mod backend;
mod common;
mod determinism;
mod fewer_steps;
mod init;
mod synthetic_video;
