//! Loads a [`Listing`] as a capture: everything decoded, in parallel, within a memory limit.

use super::lens::Undistort;
use super::{ImportOptions, Imported, ListedFrame, Listing};
use crate::error::AtPath;
use crate::files::in_parallel;
use crate::{Fault, ReadError};
use m4_core::{Camera, Capture, CaptureFrame, CompactDepth, CompactIds, CompactMask, Progress, Tracks};
use std::path::Path;

/// Bytes of eight pixels: colour, depth of 32 bits, and room for a mask.
const BYTES_PER_8_PIXELS: u64 = 64;

/// Decodes what `listing` names; `path` is the source, for messages.
///
/// # Errors
///
/// [`ReadError`], which names the frame at fault.
pub fn load(
    path: &Path,
    listing: Listing,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Imported, ReadError> {
    load_of(path, listing, BYTES_PER_8_PIXELS, options, progress)
}

/// As [`load`], where eight pixels take `bytes_per_8_pixels`.
pub(crate) fn load_of(
    path: &Path,
    listing: Listing,
    bytes_per_8_pixels: u64,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Imported, ReadError> {
    let Listing { train, test, time_frames, duration_s, metric, tracks } = listing;
    if train.is_empty() {
        return Err(Fault::missing("every frame of the training video", "give a source with frames").at(path));
    }
    if let Some(tracks) = tracks.as_ref().filter(|t| t.frames() != train.len()) {
        let what = format!("tracks of {} frames where {} were expected", tracks.frames(), train.len());
        return Err(Fault::bad(what, "give tracks of the same clip").at(path));
    }
    check_memory(&train, &test, bytes_per_8_pixels, options).at(path)?;
    let capture = |frames: Vec<ListedFrame>, phase, tracks: Option<Tracks>| -> Result<Capture, ReadError> {
        Ok(Capture {
            frames: in_parallel(
                phase,
                &frames,
                progress,
                || Fault::Cancelled.at(path),
                |i, frame| one(frame, time_frames).map_err(|e| e.within(path, format!("frame {i} ({})", frame.name))),
            )?,
            time_frames,
            duration_s,
            metric,
            tracks,
        })
    };
    Ok(Imported {
        train: capture(train, "read frames", tracks)?,
        test: if test.is_empty() { None } else { Some(capture(test, "read held-out views", None)?) },
    })
}

fn check_memory(
    train: &[ListedFrame],
    test: &[ListedFrame],
    bytes_per_8_pixels: u64,
    options: &ImportOptions,
) -> Result<(), Fault> {
    let pixels = |f: &ListedFrame| (f.lens.intrinsics.width as u64).saturating_mul(f.lens.intrinsics.height as u64);
    let total = train.iter().chain(test).map(pixels).fold(0u64, u64::saturating_add);
    let needed_bytes = total.saturating_mul(bytes_per_8_pixels).div_ceil(8);
    if needed_bytes <= options.max_memory_bytes {
        return Ok(());
    }
    let what = format!("a clip of {} frames", train.len() + test.len());
    Err(Fault::too_large(&what, needed_bytes, options.max_memory_bytes))
}

fn one(frame: &ListedFrame, time_frames: usize) -> Result<CaptureFrame, Fault> {
    frame.lens.check()?;
    let last = time_frames.max(1) as f64 - 1.0;
    if !(0.0..=last).contains(&frame.t) {
        let what = format!("its time is {}; 0 to {last} frames were expected", frame.t);
        return Err(Fault::bad(what, "correct the times in the source"));
    }
    if !frame.c2w.matrix().iter().all(|v| v.is_finite()) {
        return Err(Fault::bad("its pose holds a NaN or infinite value", "correct the pose in the source"));
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
        camera: Camera { intrinsics, c2w: frame.c2w },
        t: frame.t,
        rgb,
        depth,
        mask,
        motion,
        instances,
        camera_index: frame.camera_index,
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

fn got<T>(source: &Option<super::FrameSource<T>>) -> Result<Option<T>, Fault> {
    source.as_ref().map(super::FrameSource::get).transpose()
}
