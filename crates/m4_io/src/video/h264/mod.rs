//! H.264 in MP4 files, decoded in a separate process if a decoder program is registered, else in this one.
//!
//! The decoder (OpenH264) takes 8-bit 4:2:0 progressive streams of the Baseline, Main and High
//! profiles, B-frames included; [`Unsupported`] says why anything else is left to ffmpeg.

mod config;
mod decode;
mod engine;
mod read;
mod sps;
mod wire;

pub use decode::serve;
pub use read::{Outcome, count, read};

/// Why a stream is not decoded here, for "the video is ...".
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unsupported(pub String);
