//! Captures as folders of posed frames: `transforms_train.json` with images, depth maps and masks.
//!
//! The layout is nerfstudio's with a few keys more:
//!
//! ```text
//! NAME/transforms_train.json      the training video (a lone transforms.json is read too)
//! NAME/transforms_test.json       optional: held-out views
//! fl_x fl_y cx cy w h             pixels; for all frames, or inside a frame for that one. fl_y, cx and cy
//!                                 default to fl_x and the image's centre, w and h to the image's size
//! k1 k2 k3 k4 p1 p2               distortion, which is removed
//! depth_unit_scale_factor         scene units per step of the depth maps, default 0.001
//! axes                            "opengl" (default: x right, y up, z back) or "opencv"
//! metric                          true when a scene unit is a metre; default false
//! duration_s                      seconds from the first to the last frame
//! tracks_path                     optional: tracks.npz, trajectories of points on dynamic objects ([`crate::tracks`]); frames in the order of `frames`
//! time_frames                     of a test split without a training split: how many frames `time` spans
//! frames[]  file_path             image, relative to the JSON file; PNG or JPEG
//!           transform_matrix      4x4 camera-to-world
//!           time                  0..1, first to last training frame; default: the frame's index
//!           depth_file_path       optional: 16-bit PNG of z-depth, 0 = unknown
//!           mask_path             optional: 255 = dynamic
//!           motion_path           optional: how likely a pixel is dynamic, 255 = certainly; any size
//!           instance_path         optional: the object that a pixel shows, the same number in all frames, 0 = none; greyscale PNG of 8
//!                                 or 16 bits, any size
//!           camera                optional: index of a held-out camera
//!           distance_sigma        optional: relative standard deviation of the distance of the frame's dynamic objects
//! ```
//!
//! The reader is that of [`crate::dataset::nerfstudio`].

pub use crate::pose::Axes;

use crate::dataset::nerfstudio::{Frame, LensKeys, TRAINING_LIST, Transforms, list_capture, rows};
use crate::dataset::{FrameSource, ImportOptions, Lens, ListedFrame, Listing, load};
use crate::error::AtPath;
use crate::files::in_parallel;
use crate::reach::Reach;
use crate::{Fault, ReadError, WriteError, atomic, image, results, tracks};
use m4_core::{Capture, CaptureFrame, CompactDepth, Progress};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::{fs, io};

/// The file of tracks that [`write()`] puts beside the list of training frames, if there are
/// tracks.
pub const TRACKS_FILE: &str = "tracks.npz";
/// Bytes of eight pixels: colour, 16-bit depth and mask, 3 + 2 + 1/8 per pixel.
const BYTES_PER_8_PIXELS: u64 = 41;

/// The lists of frames that a capture has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// The training video.
    Train,
    /// Held-out views, for scoring alone.
    Test,
    /// Held-out views close to the training camera, for scoring alone; benchmark scenes have them.
    Near,
    /// Held-out views of the training camera between training frames, for scoring alone; benchmark
    /// scenes have them.
    Between,
}

impl Split {
    /// The JSON file that lists the frames.
    #[must_use]
    pub fn file_name(self) -> &'static str {
        match self {
            Self::Train => TRAINING_LIST,
            Self::Test => "transforms_test.json",
            Self::Near => "transforms_near.json",
            Self::Between => "transforms_between.json",
        }
    }

    /// The file of tracks that is written.
    fn tracks_file(self) -> &'static str {
        match self {
            Self::Train => TRACKS_FILE,
            Self::Test => "test_tracks.npz",
            Self::Near => "near_tracks.npz",
            Self::Between => "between_tracks.npz",
        }
    }

    /// Folders of the images, depth maps, masks, maps of motion and maps of instances that are
    /// written.
    #[must_use]
    pub fn folders(self) -> [&'static str; 5] {
        match self {
            Self::Train => ["train", "depth", "mask", "motion", "instance"],
            Self::Test => [
                "test",
                "test_depth",
                "test_mask",
                "test_motion",
                "test_instance",
            ],
            Self::Near => [
                "near",
                "near_depth",
                "near_mask",
                "near_motion",
                "near_instance",
            ],
            Self::Between => [
                "between",
                "between_depth",
                "between_mask",
                "between_motion",
                "between_instance",
            ],
        }
    }
}

/// What [`read()`] may take and read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CaptureOptions {
    /// Bytes that the decoded frames (about 5 per pixel: colour, depth and mask) may take before
    /// reading is refused, and each array of the tracks. Default 4 GiB: half of the memory of a
    /// small laptop.
    pub max_memory_bytes: u64,
    /// Which files the list of frames may name. Not a setting: only the command line can allow
    /// more.
    #[serde(skip)]
    pub reach: Reach,
}

impl Default for CaptureOptions {
    fn default() -> Self {
        Self {
            max_memory_bytes: 4 << 30,
            reach: Reach::Inside,
        }
    }
}

impl CaptureOptions {
    /// The same for the reader of all data sets.
    fn of_import(&self) -> ImportOptions {
        ImportOptions {
            max_memory_bytes: self.max_memory_bytes,
            reach: self.reach,
            ..ImportOptions::default()
        }
    }
}

/// Reads a split of a capture: `path` is its folder or one of its JSON files. The layout is that of
/// [this module](self); frames come sorted by time, poses in OpenCV axes, lens distortion is
/// removed.
///
/// What was assumed (missing times) is reported to `progress`.
pub fn read(
    path: &Path,
    split: Split,
    options: &CaptureOptions,
    progress: &dyn Progress,
) -> Result<Capture, ReadError> {
    let folder = if path.is_dir() {
        Some(path)
    } else {
        path.parent()
    };
    if let Some(Err(error)) = folder.map(results::settle) {
        let hint = "the capture was being replaced, which must end before it is read";
        return Err(Fault::unavailable(error.to_string(), hint).at(path));
    }
    let file = list_of_frames(path, split);
    if !file.exists() {
        let is_link = file
            .symlink_metadata()
            .is_ok_and(|facts| facts.is_symlink());
        let what = if is_link {
            "it is a link that leads nowhere, or in a circle"
        } else {
            "it does not exist"
        };
        let what =
            format!("{what}; a capture is a folder with transforms_train.json, or such a file");
        return Err(Fault::Io(io::Error::new(io::ErrorKind::NotFound, what)).at(&file));
    }
    let options = options.of_import();
    let listing = list_capture(&file, split != Split::Train, &options, progress)?;
    Ok(load(&file, listing, BYTES_PER_8_PIXELS, &options, progress)?.train)
}

/// The JSON file that `path` stands for.
fn list_of_frames(path: &Path, split: Split) -> PathBuf {
    if !path.is_dir() {
        return path.to_path_buf();
    }
    let named = path.join(split.file_name());
    let lone = path.join("transforms.json");
    if split == Split::Train && !named.exists() && lone.exists() {
        lone
    } else {
        named
    }
}

/// Steps of a 16-bit depth map.
const MAX_STEPS: f64 = 65535.0;
/// Steps that the nearest percent of all depths should have at least: rounding costs at most 0.25 %
/// of the depth.
const MIN_STEPS: f64 = 200.0;

/// Writes one split of a capture to `folder` in the layout of [this module](self): images, masks
/// and depth as PNG, so that colours and masks come back bit by bit and poses too.
///
/// The list of frames is removed first and written last: a folder that was left half-way is not
/// taken for a capture. `progress` hears of depths that 16 bits cannot hold. Fails when the file
/// system refuses, a pose or time is NaN, or the caller asked to stop.
pub fn write(
    folder: &Path,
    capture: &Capture,
    split: Split,
    progress: &dyn Progress,
) -> Result<(), WriteError> {
    let list = folder.join(split.file_name());
    let io = |e| WriteError::io(&list, e);
    if let Some(tracks) = capture
        .tracks
        .as_ref()
        .filter(|t| t.frames() != capture.frames.len())
    {
        let (n, of) = (capture.frames.len(), tracks.frames());
        let what = format!(
            "the capture has {n} frames but tracks over {of}; compute tracks of these frames, or remove them"
        );
        return Err(WriteError::bad(&list, what));
    }
    let unit = depth_unit(capture);
    let frames = capture
        .frames
        .iter()
        .enumerate()
        .map(|(i, frame)| entry(&list, split, capture.time_frames, i, frame))
        .collect::<Result<Vec<Frame>, _>>()?;
    match fs::remove_file(&list) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(io(e)),
        _ => {}
    }
    let pairs: Vec<(&CaptureFrame, &Frame)> = capture.frames.iter().zip(&frames).collect();
    let stopped = || WriteError::cancelled(&list);
    let tracks_path = capture
        .tracks
        .as_ref()
        .map(|_| split.tracks_file().to_owned());
    // tracks are compressed by one thread
    let (clipped, tracks) = rayon::join(
        || {
            in_parallel(
                "write frames",
                &pairs,
                progress,
                stopped,
                |_, (frame, entry)| images(folder, frame, entry, unit),
            )
        },
        || match (&tracks_path, &capture.tracks) {
            (Some(name), Some(tracks)) => {
                let path = folder.join(name);
                tracks::write(&path, tracks).map_err(|e| WriteError::io(&path, e))
            }
            _ => Ok(()),
        },
    );
    let clipped: usize = clipped?.into_iter().sum();
    tracks?;
    if clipped > 0 {
        progress.warn(&format!(
            "{clipped} depths above {:.3} were written as that depth: 16 bits hold no more without losing what is near",
            MAX_STEPS * unit
        ));
    }

    let transforms = Transforms {
        lens: LensKeys {
            camera_model: Some("OPENCV".to_owned()),
            ..LensKeys::default()
        },
        depth_unit_scale_factor: Some(unit),
        axes: Some(Axes::OpenGl),
        metric: Some(capture.metric),
        duration_s: capture.duration_s,
        time_frames: (split != Split::Train).then_some(capture.time_frames),
        tracks_path,
        frames,
        ..Transforms::default()
    };
    let text = serde_json::to_vec_pretty(&transforms).map_err(|e| io(e.into()))?;
    atomic::write(&list, &text).map_err(io)
}

/// Returns the training video of a capture that [`write()`] wrote to `folder` as [`read()`] returns
/// it, bit for bit, without the files: depth in steps, times of the frames that are left.
///
/// Fails as [`read()`] does where a value is out of range, or memory does not suffice.
pub fn as_read(
    folder: &Path,
    capture: Capture,
    options: &CaptureOptions,
    progress: &dyn Progress,
) -> Result<Capture, ReadError> {
    let unit = depth_unit(&capture);
    let (before, time_frames) = (capture.time_frames, capture.frames.len());
    let listed = |(i, frame): (usize, CaptureFrame)| {
        let [image, ..] = files(Split::Train, i);
        let time = frame.t / last_moment(before);
        let lens = Lens::pinhole(frame.camera.intrinsics);
        let steps = |depth: CompactDepth| {
            CompactDepth::from_steps(image::depth_steps(&depth.to_map(), unit), unit)
        };
        ListedFrame {
            depth: frame.depth.map(steps).map(FrameSource::held),
            mask: frame.mask.map(FrameSource::held),
            motion: frame.motion.map(FrameSource::held),
            instances: frame.instances.map(FrameSource::held),
            camera_index: frame.camera_index,
            distance_sigma: frame.distance_sigma,
            ..ListedFrame::new(
                image,
                lens,
                frame.camera.c2w,
                time * (time_frames.max(1) - 1) as f64,
                FrameSource::held(frame.rgb),
            )
        }
    };
    if let Some(tracks) = &capture.tracks {
        tracks::check_places(tracks.xyz(), tracks.count()).at(&folder.join(TRACKS_FILE))?;
    }
    let listing = Listing {
        metric: capture.metric,
        tracks: capture.tracks,
        ..Listing::of_video(
            capture
                .frames
                .into_par_iter()
                .enumerate()
                .map(listed)
                .collect(),
            time_frames,
            capture.duration_s,
        )
    };
    let list = folder.join(Split::Train.file_name());
    Ok(load(
        &list,
        listing,
        BYTES_PER_8_PIXELS,
        &options.of_import(),
        progress,
    )?
    .train)
}

/// What a frame's time is divided by when it is written.
fn last_moment(time_frames: usize) -> f64 {
    (time_frames.max(2) - 1) as f64
}

/// Files of image, depth, mask, motion and instances of a frame.
fn files(split: Split, index: usize) -> [String; 5] {
    let in_folder = |folder| format!("{folder}/{index:05}.png");
    split.folders().map(in_folder)
}

/// The keys of one frame.
fn entry(
    list: &Path,
    split: Split,
    time_frames: usize,
    index: usize,
    frame: &CaptureFrame,
) -> Result<Frame, WriteError> {
    let bad =
        |what: String| WriteError::bad(list, format!("frame {index} ({:?}): {what}", frame.name));
    let time = frame.t / last_moment(time_frames);
    if !(0.0..=1.0).contains(&time) {
        let last = time_frames.max(1) - 1;
        return Err(bad(format!(
            "t = {}; 0 to {last} frames were expected",
            frame.t
        )));
    }
    let k = &frame.camera.intrinsics;
    let numbers = [k.fx, k.fy, k.cx, k.cy];
    if !frame
        .camera
        .c2w
        .matrix()
        .iter()
        .chain(&numbers)
        .all(|v| v.is_finite())
    {
        return Err(bad(format!(
            "its camera holds a NaN or infinite value: {:?}",
            frame.camera
        )));
    }
    if frame.rgb.size() != (k.width, k.height) {
        let (w, h) = frame.rgb.size();
        return Err(bad(format!(
            "its image is {w} x {h} but its camera {} x {}",
            k.width, k.height
        )));
    }
    let [image, depth, mask, motion, instances] = files(split, index);
    Ok(Frame {
        file_path: image,
        depth_file_path: frame.depth.as_ref().map(|_| depth),
        mask_path: frame.mask.as_ref().map(|_| mask),
        motion_path: frame.motion.as_ref().map(|_| motion),
        instance_path: frame.instances.as_ref().map(|_| instances),
        time: Some(time),
        camera: frame.camera_index,
        distance_sigma: frame.distance_sigma,
        lens: LensKeys::pinhole(k),
        transform_matrix: Some(rows(&frame.camera.c2w)),
    })
}

/// Writes what belongs to one frame; how many depths were too far.
fn images(
    folder: &Path,
    frame: &CaptureFrame,
    entry: &Frame,
    unit: f64,
) -> Result<usize, WriteError> {
    image::write_rgb(&folder.join(&entry.file_path), &frame.rgb)?;
    let mut far = 0;
    if let (Some(path), Some(depth)) = (&entry.depth_file_path, &frame.depth) {
        let depth = depth.to_map();
        image::write_depth(&folder.join(path), &depth, unit)?;
        let limit = (MAX_STEPS + 0.5) * unit;
        far = depth
            .data()
            .iter()
            .filter(|&&z| f64::from(z) > limit)
            .count();
    }
    if let (Some(path), Some(mask)) = (&entry.mask_path, &frame.mask) {
        image::write_mask(&folder.join(path), &mask.to_mask())?;
    }
    if let (Some(path), Some(motion)) = (&entry.motion_path, &frame.motion) {
        image::write_grey(&folder.join(path), motion)?;
    }
    if let (Some(path), Some(ids)) = (&entry.instance_path, &frame.instances) {
        image::write_ids(&folder.join(path), ids)?;
    }
    Ok(far)
}

/// Scene units per step of depth maps: the finest with which the farthest depth fits, unless the
/// near would become coarse.
fn depth_unit(capture: &Capture) -> f64 {
    let mut depth_samples: Vec<f32> = capture
        .frames
        .iter()
        .filter_map(|f| f.depth.as_ref())
        // Every 16th pixel is plenty for a percentile; the maximum is taken over all of them below.
        .flat_map(|d| d.every(16))
        .filter(|z| z.is_finite() && *z > 0.0)
        .collect();
    let depths = capture
        .frames
        .iter()
        .filter_map(|f| f.depth.as_ref())
        .flat_map(|d| d.every(1));
    let farthest = depths.filter(|z| z.is_finite()).fold(0.0, f32::max);
    if depth_samples.is_empty() || farthest <= 0.0 {
        return 1e-3;
    }
    depth_samples.sort_by(f32::total_cmp);
    let near = f64::from(depth_samples[depth_samples.len() / 100]);
    (f64::from(farthest) / MAX_STEPS).min(near / MIN_STEPS)
}
