//! The integration tests of this crate, in one program.

mod common;
mod determinism;
mod device;
mod fewer_steps;
mod init;
mod synthetic_video;
