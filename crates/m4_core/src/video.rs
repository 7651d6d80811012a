//! Frames as they come out of a decoder.

use crate::RgbImage;

/// One decoded image, upright.
#[derive(Debug, Clone)]
pub struct VideoFrame {
    /// The image, after the display matrix was applied.
    pub rgb: RgbImage,
    /// Presentation time, seconds from the first frame of the file.
    pub time_s: f64,
}

/// A clip.
#[derive(Debug, Clone)]
pub struct Video {
    /// At least one, in order of time, all of one size.
    pub frames: Vec<VideoFrame>,
    /// Notes of the reader for the user: damaged frames, tone mapping, sub-sampling.
    pub warnings: Vec<String>,
    /// Focal length in pixels of these frames, where the file states it.
    pub focal_px: Option<f64>,
}
