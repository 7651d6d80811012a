//! The integration tests of this crate, in one program.

mod cvd_bench;
mod dense;
mod megasam;
mod sparse;
mod track_support;
mod tracking;
mod tracks3d;
