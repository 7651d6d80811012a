//! The frames of the stage and what the user provides of them.

use super::between::Between;
use super::given::Given;
use super::methods::Context;
use crate::Error;
use m4_core::{Camera, Capture, CaptureFrame, CompactDepth, CompactMask, Plane, RgbImage, Tracks, Video};
use m4_geometry::classical::sparse::SparseConfig;
use std::path::Path;

/// A clip and what is known of it.
pub(super) struct Clip {
    pub video: Video,
    pub given: Given,
    /// Settings of the reconstruction, with what the file and the user say of the lens.
    pub sparse: SparseConfig,
    /// The focal length in pixels of the frames that settings or the file state.
    pub focal_px: Option<f64>,
}

/// What geometry finds of a frame.
pub(super) struct FrameGeometry {
    pub camera: Camera,
    pub depth: CompactDepth,
    pub mask: CompactMask,
    pub motion: Option<Plane<u8>>,
}

impl Clip {
    /// Reads the clip and the files that the user provides.
    ///
    /// # Errors
    ///
    /// [`Error`]: a file is missing, damaged, or does not fit the clip.
    pub fn read(input: &Path, between: Between, context: &Context<'_>) -> Result<Self, Error> {
        let (settings, observer) = (context.settings, context.observer());
        let video = m4_io::video::read(input, &between.to_read(&settings.video), observer)?;
        for warning in &video.warnings {
            observer.warn(warning);
        }
        let mut sparse = settings.sparse.clone();
        if sparse.fov_deg.is_none() && sparse.focal_px.is_none() {
            sparse.focal_px = video.focal_px;
        }
        let width = video.frames.first().map_or(0, |f| f.rgb.width());
        let from_fov = |fov: f64| 0.5 * width as f64 / (0.5 * fov.to_radians()).tan();
        let focal_px = sparse.focal_px.or(sparse.fov_deg.map(from_fov));
        let given = Given::read(&settings.geometry, input, &video, settings.video.folder_fps, focal_px)?;
        if let Some(lens) = given.lens {
            sparse.intrinsics = Some([lens.fx, lens.fy, lens.cx, lens.cy]);
        }
        Ok(Self {
            video,
            given,
            sparse,
            focal_px,
        })
    }

    /// The images.
    pub fn images(&self) -> Vec<&RgbImage> {
        self.video.frames.iter().map(|f| &f.rgb).collect()
    }

    /// The capture of these frames; lengths are metres if `metric`.
    pub fn capture(self, found: impl Iterator<Item = FrameGeometry>, metric: bool, tracks: Option<Tracks>) -> Capture {
        let time_frames = self.video.frames.len();
        let (moments, duration_s) = moments(&self.video);
        let frames = self.video.frames.into_iter().zip(found).zip(moments).enumerate();
        let frames = frames.map(|(i, ((frame, found), t))| CaptureFrame {
            name: format!("{i:05}"),
            camera: found.camera,
            t,
            rgb: frame.rgb,
            depth: Some(found.depth),
            mask: Some(found.mask),
            motion: found.motion,
            instances: None,
            camera_index: None,
        });
        Capture {
            frames: frames.collect(),
            time_frames,
            duration_s,
            metric,
            tracks,
        }
    }
}

/// The times of the frames in frames of the video, 0 to the number of frames less one, and the duration, seconds.
fn moments(video: &Video) -> (Vec<f64>, Option<f64>) {
    let times_s: Vec<f64> = video.frames.iter().map(|f| f.time_s).collect();
    let (first_s, last_s) = (times_s.first().copied(), times_s.last().copied());
    let duration_s = last_s.unwrap_or(0.0) - first_s.unwrap_or(0.0);
    let last = times_s.len().saturating_sub(1) as f64;
    let moment = |(i, time_s): (usize, &f64)| {
        if duration_s > 0.0 {
            ((time_s - first_s.unwrap_or(0.0)) / duration_s * last).clamp(0.0, last)
        } else {
            i as f64
        }
    };
    let moments = times_s.iter().enumerate().map(moment).collect();
    (moments, (duration_s > 0.0).then_some(duration_s))
}
