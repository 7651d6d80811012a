//! The integration tests of this crate, in one program.

mod dense;
mod megasam;
mod sparse;
mod tracking;
mod tracks3d;
