//! Clips decoded by `ffmpeg`, a child process that sends raw images through a pipe.
//!
//! The child is a separate program of the user's machine: nothing is linked, and a decoder that
//! crashes on a damaged file takes only itself down. It turns images upright itself.

mod child;
mod log;
mod probe;
mod read;

pub use read::read;
