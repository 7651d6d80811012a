//! Which part of a clip is read, how large, and within which limits.

use super::decoder::DecoderLimits;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Settings of [`super::read()`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VideoOptions {
    /// Keep at most this many frames, evenly spaced from the first to the last. Default: all.
    pub max_frames: Option<usize>,
    /// Shrink frames so that their longest side has this many pixels; smaller frames stay as they are.
    /// Default 640, between the 480 of the paper's DyCheck runs and the width of 360p video.
    /// `None` keeps the size of the file.
    pub size: Option<usize>,
    /// Leave out what is shown before, seconds from the first frame. Default: nothing.
    pub start_s: Option<f64>,
    /// Leave out what is shown after, seconds from the first frame. Default: nothing.
    pub end_s: Option<f64>,
    /// Damaged frames are an error, in place of being left out with a warning. Default false.
    pub strict: bool,
    /// Bytes that the frames (3 per pixel, after shrinking) may take before reading is refused.
    /// Default 4 GiB: half of the memory of a small laptop.
    pub max_memory_bytes: u64,
    /// Frames per second of a folder of images, which has no times of its own. Default 30.
    pub folder_fps: f64,
    /// The program that decodes what this one does not (all but 8-bit H.264 in MP4 and MOV files);
    /// `ffprobe` is expected beside it. Default `ffmpeg`, looked up on the PATH.
    pub ffmpeg: PathBuf,
    /// What the processes that decode may take.
    pub decoder: DecoderLimits,
}

impl Default for VideoOptions {
    fn default() -> Self {
        Self {
            max_frames: None,
            size: Some(640),
            start_s: None,
            end_s: None,
            strict: false,
            max_memory_bytes: 4 << 30,
            folder_fps: 30.0,
            ffmpeg: PathBuf::from("ffmpeg"),
            decoder: DecoderLimits::default(),
        }
    }
}
