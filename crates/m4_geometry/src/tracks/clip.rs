//! A clip whose frames are asked for one at a time.

use super::TrackError;
use m4_core::{Camera, Capture, DepthMap, Mask, Plane, RgbImage};

/// One frame with its geometry, all planes of the size of the camera's image.
#[derive(Debug, Clone)]
pub struct PosedFrame {
    /// sRGB.
    pub rgb: RgbImage,
    /// z-depth, world units; 0 or less, or not a number, where unknown.
    pub depth: DepthMap,
    /// Above 0 where something moves.
    pub moving: Mask,
    /// Lens and pose.
    pub camera: Camera,
}

impl PosedFrame {
    /// Refuses planes that are not of one size, and cameras that are not finite.
    pub(crate) fn check(&self) -> Result<(), String> {
        let size = self.rgb.size();
        let k = &self.camera.intrinsics;
        if self.depth.size() != size || self.moving.size() != size || (k.width, k.height) != size {
            return Err(format!(
                "image {size:?}, depth {:?}, mask {:?} and camera {:?} are not of one size",
                self.depth.size(),
                self.moving.size(),
                (k.width, k.height)
            ));
        }
        if size.0.min(size.1) < 2 {
            return Err(format!("{size:?} pixels are too few"));
        }
        let pose = &self.camera.c2w;
        let finite = |v: &[f64]| v.iter().all(|v| v.is_finite());
        let lens = [k.fx, k.fy, k.cx, k.cy];
        if !finite(&lens) || k.fx <= 0.0 || k.fy <= 0.0 {
            return Err("its focal length is not a number above 0".to_owned());
        }
        if !finite(pose.rotation.as_slice()) || !finite(pose.translation.as_slice()) {
            return Err("its pose is not finite".to_owned());
        }
        Ok(())
    }
}

/// A posed clip. Frames are read when they are looked at, several at once from different threads, and again when they are
/// looked at again, so that a long clip need not be in memory; the same frame must always be the same bits.
pub trait PosedClip: Sync {
    /// Number of frames.
    fn frames(&self) -> usize;

    /// Frame `index`; all frames have one size.
    ///
    /// # Errors
    ///
    /// [`TrackError::Frame`] where it cannot be read.
    fn read(&self, index: usize) -> Result<PosedFrame, TrackError>;
}

impl PosedClip for Vec<PosedFrame> {
    fn frames(&self) -> usize {
        self.len()
    }

    fn read(&self, index: usize) -> Result<PosedFrame, TrackError> {
        self.get(index)
            .cloned()
            .ok_or_else(|| frame_error(index, "the clip ends before it"))
    }
}

/// A capture as a clip: images, depth and masks at one size.
#[derive(Debug, Clone, Copy)]
pub struct CaptureClip<'a> {
    capture: &'a Capture,
    size: (usize, usize),
}

impl<'a> CaptureClip<'a> {
    /// The frames of `capture` with their longest side at most `side_px`: images are shrunk by the mean of their pixels, depth and masks
    /// read at the nearest. A frame without depth or mask has none of it, and is not followed through.
    #[must_use]
    pub fn new(capture: &'a Capture, side_px: usize) -> Self {
        let (w, h) = capture.frames.first().map_or((0, 0), |f| f.rgb.size());
        Self {
            capture,
            size: crate::classical::dense::working_size(w, h, side_px.max(2)),
        }
    }

    /// Width and height of its frames.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        self.size
    }
}

impl PosedClip for CaptureClip<'_> {
    fn frames(&self) -> usize {
        self.capture.frames.len()
    }

    fn read(&self, index: usize) -> Result<PosedFrame, TrackError> {
        let frame = self
            .capture
            .frames
            .get(index)
            .ok_or_else(|| frame_error(index, "the capture ends before it"))?;
        let (w, h) = self.size;
        let nearest =
            |x: usize, y: usize, (fw, fh): (usize, usize)| ((2 * x + 1) * fw / (2 * w), (2 * y + 1) * fh / (2 * h));
        let depth = Plane::from_fn(w, h, |x, y| {
            frame.depth.as_ref().map_or(0.0, |d| {
                let (x, y) = nearest(x, y, d.size());
                d.at(x, y)
            })
        });
        let moving = Plane::from_fn(w, h, |x, y| {
            frame.mask.as_ref().map_or(0, |m| {
                let (x, y) = nearest(x, y, m.size());
                if m.at(x, y) { 255 } else { 0 }
            })
        });
        if frame.rgb.width() < w || frame.rgb.height() < h {
            return Err(frame_error(index, "it is smaller than the first frame"));
        }
        Ok(PosedFrame {
            rgb: crate::resample::resize_area(&frame.rgb, w, h),
            depth,
            moving,
            camera: frame.camera.resized(w, h),
        })
    }
}

/// [`TrackError::Frame`] with a reason in words.
pub(crate) fn frame_error(frame: usize, reason: impl Into<String>) -> TrackError {
    TrackError::Frame {
        frame,
        reason: reason.into().into(),
    }
}

/// Frame `index`, checked.
pub(crate) fn read_checked(clip: &dyn PosedClip, index: usize) -> Result<PosedFrame, TrackError> {
    let frame = clip.read(index)?;
    frame.check().map_err(|reason| frame_error(index, reason))?;
    Ok(frame)
}
