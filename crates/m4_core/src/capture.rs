//! What stages exchange: the decoded video, frames with their geometry, the trained scene.

use crate::{Camera, CompactDepth, CompactIds, CompactMask, Plane, RgbImage, Splats, Tracks};

/// One posed frame.
#[derive(Debug, Clone)]
pub struct CaptureFrame {
    /// As in `file_path`, for messages and reports.
    pub name: String,
    /// Lens and pose.
    pub camera: Camera,
    /// When it was taken, in frames of the training video: `time * (frames - 1)` of a file's `time`
    /// in `[0, 1]`.
    pub t: f64,
    /// The image.
    pub rgb: RgbImage,
    /// z-depth in the unit of the poses, 0 where unknown; the size may differ from that of `rgb`.
    pub depth: Option<CompactDepth>,
    /// The dynamic part; the size may differ from that of `rgb`.
    pub mask: Option<CompactMask>,
    /// Probability that each pixel is dynamic, 255 = certain; `None` if not estimated; the size may
    /// differ from that of `rgb`.
    pub motion: Option<Plane<u8>>,
    /// Which thing each pixel shows, the same number in all frames, 0 for none; `None` if objects
    /// were not segmented; the size may differ from that of `rgb`.
    pub instances: Option<CompactIds>,
    /// Which held-out camera took it; `None` for training frames.
    pub camera_index: Option<u32>,
    /// Relative standard deviation of the distance of its dynamic objects, above 0; `None` where it
    /// has none, or nothing is known of it.
    pub distance_sigma: Option<f32>,
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
    /// Trajectories of points on dynamic objects, indexed like `frames`; `None` if no points were
    /// tracked.
    pub tracks: Option<Tracks>,
}

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
    /// Frames of the part of the clip that was asked for, kept or not.
    pub in_range: usize,
    /// Notes of the reader for the user: damaged frames, tone mapping, sub-sampling.
    pub warnings: Vec<String>,
    /// Focal length in pixels of these frames, where the file states it.
    pub focal_px: Option<f64>,
}

/// Per-frame colour correction `c' = matrix c + offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// Row-major 3x3, identity when nothing is corrected.
    pub matrix: [[f32; 3]; 3],
    /// Added after the matrix.
    pub offset: [f32; 3],
}

impl Exposure {
    /// Changes nothing.
    pub const IDENTITY: Self = Self {
        matrix: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        offset: [0.0; 3],
    };
}

/// Camera, moment and exposure of one training frame, as optimised.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SourceFrame {
    /// Lens and pose.
    pub camera: Camera,
    /// Frames.
    pub t: f64,
    /// Colour correction of this frame.
    pub exposure: Exposure,
    /// As in [`CaptureFrame::distance_sigma`].
    pub distance_sigma: Option<f32>,
}

/// Splats and the cameras that saw them.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// The Gaussians.
    pub splats: Splats,
    /// Colour behind everything, 0..1.
    pub background: [f32; 3],
    /// Time runs from 0 to `time_frames - 1` frames.
    pub time_frames: usize,
    /// Seconds from the first to the last frame, where known.
    pub duration_s: Option<f64>,
    /// Opacity-compensated 2D filter on (Mip filter, docs/spec/optimiser.md 1.6).
    pub mip: bool,
    /// Splats nearer than this z-depth are not drawn, world units.
    pub near: f32,
    /// The training cameras, in order of time.
    pub source: Vec<SourceFrame>,
}

impl Scene {
    /// Period of the first harmonic of time, frames: the length of the clip
    /// (docs/spec/optimiser.md 1.8).
    #[must_use]
    pub fn period_frames(&self) -> f64 {
        (self.time_frames.max(2) - 1) as f64
    }
}
