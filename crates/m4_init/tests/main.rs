//! The integration tests of this crate, in one program.

mod initialise;
mod tracked;
mod tracks;
