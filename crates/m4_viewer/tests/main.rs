//! The integration tests of this crate, in one program.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod bound;
mod contents;
mod page;
mod payload_fixture;
mod server;
mod turning;
