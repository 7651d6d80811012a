//! Frames with their geometry: what training needs.

use crate::{Camera, CompactDepth, CompactIds, CompactMask, Plane, RgbImage, Tracks};

/// One posed frame.
#[derive(Debug, Clone)]
pub struct CaptureFrame {
    /// As in `file_path`, for messages and reports.
    pub name: String,
    /// Lens and pose.
    pub camera: Camera,
    /// When it was taken, in frames of the training video: `time * (frames - 1)` of a file's `time` in `[0, 1]`.
    pub t: f64,
    /// The image.
    pub rgb: RgbImage,
    /// z-depth in the unit of the poses, 0 where unknown; the size may differ from that of `rgb`.
    pub depth: Option<CompactDepth>,
    /// The dynamic part; the size may differ from that of `rgb`.
    pub mask: Option<CompactMask>,
    /// Probability that each pixel is dynamic, 255 = certain; `None` if not estimated; the size may differ from that of `rgb`.
    pub motion: Option<Plane<u8>>,
    /// Which thing each pixel shows, the same number in all frames, 0 for none; `None` if objects were not segmented; the size may differ
    /// from that of `rgb`.
    pub instances: Option<CompactIds>,
    /// Which held-out camera took it; `None` for training frames.
    pub camera_index: Option<u32>,
}

/// A video with poses, depth and motion masks: the seam between geometry and training.
#[derive(Debug, Clone)]
pub struct Capture {
    /// In order of time.
    pub frames: Vec<CaptureFrame>,
    /// Number of frames that the unit of time refers to: `t` runs from 0 to `time_frames - 1`.
    pub time_frames: usize,
    /// Duration of the video from first to last frame, seconds, if known.
    pub duration_s: Option<f64>,
    /// True when depth and poses are metres; false when their scale is arbitrary.
    pub metric: bool,
    /// Trajectories of points on dynamic objects, indexed like `frames`; `None` if no points were tracked.
    pub tracks: Option<Tracks>,
}
