//! The listing of a source: what a format knows before anything large is read.

use super::{Lens, SourceErrorCause};
use m4_core::{Capture, CompactDepth, CompactIds, CompactMask, Plane, RgbImage, Se3, Tracks};
use std::fmt;
use std::sync::Mutex;

/// How to get one image, map or mask when its turn comes; called from several threads, once.
pub struct FrameSource<T>(Box<dyn Fn() -> Result<T, SourceErrorCause> + Send + Sync>);

impl<T> FrameSource<T> {
    /// Creates a loader from a function.
    pub fn new(get: impl Fn() -> Result<T, SourceErrorCause> + Send + Sync + 'static) -> Self {
        Self(Box::new(get))
    }

    /// Of what is already in memory. It is given out once.
    pub fn held(value: T) -> Self
    where
        T: Send + 'static,
    {
        let held = Mutex::new(Some(value));
        Self::new(move || {
            let taken = held.lock().ok().and_then(|mut held| held.take());
            taken.ok_or_else(|| SourceErrorCause::bad("an image or map was asked for twice", "list the source again"))
        })
    }

    /// Reads and decodes it.
    ///
    /// # Errors
    ///
    /// [`SourceErrorCause`].
    pub fn get(&self) -> Result<T, SourceErrorCause> {
        (self.0)()
    }
}

impl<T> fmt::Debug for FrameSource<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("FrameSource")
    }
}

/// One frame, its camera known and its images still where they are.
#[derive(Debug)]
pub struct ListedFrame {
    /// For messages and reports.
    pub name: String,
    /// Lens of the image as it is stored.
    pub lens: Lens,
    /// Camera to world, OpenCV axes.
    pub c2w: Se3<f64>,
    /// When it was taken, in frames of the training video, `0 ..= time_frames - 1`.
    pub t: f64,
    /// The image; its size must be that of the lens.
    pub rgb: FrameSource<RgbImage>,
    /// z-depth in the unit of the poses, 0 where unknown; of any size, through the same lens.
    pub depth: Option<FrameSource<CompactDepth>>,
    /// The dynamic part; of any size, through the same lens.
    pub mask: Option<FrameSource<CompactMask>>,
    /// How likely each pixel is to move, 255 = certainly.
    pub motion: Option<FrameSource<Plane<u8>>>,
    /// The object that each pixel shows.
    pub instances: Option<FrameSource<CompactIds>>,
    /// Which held-out camera took it; `None` for training frames.
    pub camera_index: Option<u32>,
}

impl ListedFrame {
    /// A training frame of an image alone.
    #[must_use]
    pub fn new(name: String, lens: Lens, c2w: Se3<f64>, t: f64, rgb: FrameSource<RgbImage>) -> Self {
        Self {
            name,
            lens,
            c2w,
            t,
            rgb,
            depth: None,
            mask: None,
            motion: None,
            instances: None,
            camera_index: None,
        }
    }
}

/// A source, read but for its images.
#[derive(Debug)]
pub struct Listing {
    /// The training video, in order of time.
    pub train: Vec<ListedFrame>,
    /// Held-out views, in any order; may be empty.
    pub test: Vec<ListedFrame>,
    /// Frames that the unit of time refers to: `t` runs from 0 to `time_frames - 1`.
    pub time_frames: usize,
    /// Seconds from the first to the last frame, where known.
    pub duration_s: Option<f64>,
    /// Depth and poses are metres.
    pub metric: bool,
    /// Trajectories of points on dynamic objects, frames in the order of `train`.
    pub tracks: Option<Tracks>,
}

impl Listing {
    /// A training video without held-out views and tracks, of `time_frames` moments, in no known unit.
    #[must_use]
    pub fn of_video(train: Vec<ListedFrame>, time_frames: usize, duration_s: Option<f64>) -> Self {
        Self {
            train,
            test: Vec::new(),
            time_frames,
            duration_s,
            metric: false,
            tracks: None,
        }
    }
}

/// A source, read.
#[derive(Debug, Clone)]
pub struct Imported {
    /// The training video.
    pub train: Capture,
    /// Held-out views, where the source has some.
    pub test: Option<Capture>,
}
