//! The integration tests of this crate, in one program.

mod common;
mod contents;
mod page;
mod payload_fixture;
mod server;
