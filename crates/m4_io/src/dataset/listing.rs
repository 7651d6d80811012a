//! The listing of a source: what a format knows before anything large is read, and what files do
//! not say. It is loaded as a capture: everything decoded, in parallel, within a memory limit.

use super::Lens;
use super::lens::Undistort;
use crate::error::AtPath;
use crate::files::in_parallel;
use crate::reach::Reach;
use crate::{Fault, ReadError, range, shortened};
use m4_core::{
    Camera, Capture, CaptureFrame, CompactDepth, CompactIds, CompactMask, Plane, Progress,
    RgbImage, Se3, Tracks,
};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// How to get one image, map or mask when its turn comes; called from several threads, once.
pub struct FrameSource<T>(Box<dyn Fn() -> Result<T, Fault> + Send + Sync>);

impl<T> FrameSource<T> {
    /// Creates a loader from a function.
    pub fn new(get: impl Fn() -> Result<T, Fault> + Send + Sync + 'static) -> Self {
        Self(Box::new(get))
    }

    /// Of what is already in memory. It is given out once.
    pub fn held(value: T) -> Self
    where
        T: Send + 'static,
    {
        let held = Mutex::new(Some(value));
        Self::new(move || {
            let item = held.lock().ok().and_then(|mut held| held.take());
            item.ok_or_else(|| {
                Fault::bad(
                    "an image or map was asked for twice",
                    "list the source again",
                )
            })
        })
    }

    /// Reads and decodes it.
    pub fn get(&self) -> Result<T, Fault> {
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
    /// Relative standard deviation of the distance of its dynamic objects, where known.
    pub distance_sigma: Option<f32>,
}

impl ListedFrame {
    /// A training frame of an image alone.
    #[must_use]
    pub fn new(
        name: String,
        lens: Lens,
        c2w: Se3<f64>,
        t: f64,
        rgb: FrameSource<RgbImage>,
    ) -> Self {
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
            distance_sigma: None,
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
    /// A training video without held-out views and tracks, of `time_frames` moments, in no known
    /// unit.
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

/// What the files of a source do not say, and how much of them is read. Each format uses what it
/// has a use for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ImportOptions {
    /// Frames per second, above 0, where the files have no clock; `None` takes 30 and says so.
    pub fps: Option<f64>,
    /// Folder or video of the images, where they lie elsewhere; `None` looks where the format has
    /// them.
    #[serde(rename = "images")]
    pub images: Option<PathBuf>,
    /// Folder of depth maps, one per frame in the order of names (PNG of 16 bits, EXR, npy).
    pub depth: Option<PathBuf>,
    /// Folder of masks, one per frame in the order of names.
    pub masks: Option<PathBuf>,
    /// By what the images of a data set are shrunk (DyCheck: `rgb/2x`); `None` takes what the
    /// protocols use.
    pub factor: Option<u32>,
    /// Bytes that the decoded frames (8 per pixel) may take before reading is refused. Default 4
    /// GiB, as of a capture.
    pub max_memory_bytes: u64,
    /// Which images, maps and tracks are read: those in the folder of the source and in what the
    /// options above name, or any. Not a setting: only the command line can allow more.
    #[serde(skip)]
    pub reach: Reach,
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self {
            fps: None,
            images: None,
            depth: None,
            masks: None,
            factor: None,
            max_memory_bytes: 4 << 30,
            reach: Reach::Inside,
        }
    }
}

/// Decodes what `listing` names, where eight pixels take `bytes_per_8_pixels`; `path` is the
/// source, for messages.
pub(crate) fn load(
    path: &Path,
    listing: Listing,
    bytes_per_8_pixels: u64,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Imported, ReadError> {
    let Listing {
        train,
        test,
        time_frames,
        duration_s,
        metric,
        tracks,
    } = listing;
    if train.is_empty() {
        return Err(Fault::missing(
            "every frame of the training video",
            "give a source with frames",
        )
        .at(path));
    }
    if let Some(tracks) = tracks.as_ref().filter(|t| t.frames() != train.len()) {
        let what = format!(
            "tracks of {} frames where {} were expected",
            tracks.frames(),
            train.len()
        );
        return Err(Fault::bad(what, "give tracks of the same clip").at(path));
    }
    check_rate(time_frames, duration_s).at(path)?;
    warn_of_repetitions(path, &train, progress);
    check_memory(&train, &test, bytes_per_8_pixels, options).at(path)?;
    let capture =
        |frames: Vec<ListedFrame>, phase, tracks: Option<Tracks>| -> Result<Capture, ReadError> {
            Ok(Capture {
                frames: in_parallel(
                    phase,
                    &frames,
                    progress,
                    || Fault::Cancelled.at(path),
                    |i, frame| {
                        one(frame, time_frames)
                            .map_err(|e| e.within(path, format!("frame {i} ({})", frame.name)))
                    },
                )?,
                time_frames,
                duration_s,
                metric,
                tracks,
            })
        };
    Ok(Imported {
        train: capture(train, "read frames", tracks)?,
        test: if test.is_empty() {
            None
        } else {
            Some(capture(test, "read held-out views", None)?)
        },
    })
}

/// Names the image that is listed most often, where one is more than once.
fn warn_of_repetitions(path: &Path, train: &[ListedFrame], progress: &dyn Progress) {
    let mut times = HashMap::new();
    train
        .iter()
        .for_each(|frame| *times.entry(frame.name.as_str()).or_insert(0) += 1);
    let most = train
        .iter()
        .map(|frame| (times[frame.name.as_str()], &frame.name))
        .max_by_key(|(n, _)| *n);
    if let Some((n, name)) = most.filter(|(n, _)| *n > 1) {
        progress.warn(&format!(
            "{} lists the image {} {n} times, {} images for {} frames; each frame should have its own",
            path.display(),
            shortened(name),
            times.len(),
            train.len()
        ));
    }
}

/// Refuses a duration that would make frames per second that cannot be.
fn check_rate(time_frames: usize, duration_s: Option<f64>) -> Result<(), Fault> {
    let steps = time_frames.saturating_sub(1) as f64;
    match duration_s.filter(|s| *s != 0.0 && steps > 0.0) {
        Some(s) => {
            let field = format!("the frame rate, {steps} steps in {} s,", range::short(s));
            range::check(
                &field,
                steps / s,
                &range::FPS,
                "frames per second",
                "correct the times in the source",
            )
        }
        None => Ok(()),
    }
}

fn check_memory(
    train: &[ListedFrame],
    test: &[ListedFrame],
    bytes_per_8_pixels: u64,
    options: &ImportOptions,
) -> Result<(), Fault> {
    let pixels = |f: &ListedFrame| {
        (f.lens.intrinsics.width as u64).saturating_mul(f.lens.intrinsics.height as u64)
    };
    let total = train
        .iter()
        .chain(test)
        .map(pixels)
        .fold(0u64, u64::saturating_add);
    let needed_bytes = total.saturating_mul(bytes_per_8_pixels).div_ceil(8);
    if needed_bytes <= options.max_memory_bytes {
        return Ok(());
    }
    let what = format!("a clip of {} frames", train.len() + test.len());
    Err(Fault::too_large(
        &what,
        needed_bytes,
        options.max_memory_bytes,
    ))
}

fn one(frame: &ListedFrame, time_frames: usize) -> Result<CaptureFrame, Fault> {
    frame.lens.check()?;
    let last = time_frames.max(1) as f64 - 1.0;
    if !(0.0..=last).contains(&frame.t) {
        let what = format!("its time is {}; 0 to {last} frames were expected", frame.t);
        return Err(Fault::bad(what, "correct the times in the source"));
    }
    // once more: it may have been scaled and moved since it was read
    if let Some(what) = range::of_place("the translation of its pose", &frame.c2w.translation) {
        return Err(Fault::bad(what, "correct the pose in the source"));
    }
    let undistort = Undistort::new(&frame.lens)?;
    let rgb = frame.rgb.get()?;
    frame.lens.check_size(rgb.size())?;
    let (mut depth, mut mask) = (got(&frame.depth)?, got(&frame.mask)?);
    let (mut motion, mut instances) = (got(&frame.motion)?, got(&frame.instances)?);
    let (mut rgb, mut intrinsics) = (rgb, frame.lens.intrinsics);
    if let Some(map) = undistort {
        rgb = map.rgb(&rgb);
        intrinsics = map.to;
        depth = depth.map(|d| CompactDepth::from(map.nearest(&d.to_map())));
        mask = mask.map(|m| CompactMask::from(map.nearest(&m.to_mask())));
        motion = motion.map(|m| map.nearest(&m));
        instances = instances.map(|i| CompactIds::from(&map.nearest(&i.to_plane())));
    }
    Ok(CaptureFrame {
        name: frame.name.clone(),
        camera: Camera {
            intrinsics,
            c2w: frame.c2w,
        },
        t: frame.t,
        rgb,
        depth,
        mask,
        motion,
        instances,
        camera_index: frame.camera_index,
        distance_sigma: frame.distance_sigma,
    })
}

/// Says that the `i`th of `n` steps of a loop begins, or stops it.
pub(crate) fn step(phase: &str, i: usize, n: usize, progress: &dyn Progress) -> Result<(), Fault> {
    if progress.cancelled() {
        return Err(Fault::Cancelled);
    }
    progress.update(phase, i + 1, n, "");
    Ok(())
}

fn got<T>(source: &Option<FrameSource<T>>) -> Result<Option<T>, Fault> {
    source.as_ref().map(FrameSource::get).transpose()
}
