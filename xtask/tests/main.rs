//! The integration tests of this crate, in one program.

mod arrows;
mod page;
mod paper;
mod tests;
