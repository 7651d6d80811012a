//! Loads a [`Listing`] as a capture: everything decoded, in parallel, within a memory limit.

use super::undistort::Undistort;
use super::{ImportOptions, Imported, ListedFrame, Listing, ReadSourceError, SourceErrorCause};
use m4_core::{Camera, Capture, CaptureFrame, CompactDepth, CompactIds, CompactMask, Progress, Tracks};
use rayon::prelude::*;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Bytes of eight pixels: colour, depth of 32 bits, and room for a mask.
const BYTES_PER_8_PIXELS: u64 = 64;

/// Decodes what `listing` names; `path` is the source, for messages.
///
/// # Errors
///
/// [`ReadSourceError`], which names the frame at fault.
pub fn load(
    path: &Path,
    listing: Listing,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Imported, ReadSourceError> {
    load_of(path, listing, BYTES_PER_8_PIXELS, options, progress)
}

/// As [`load`], where eight pixels take `bytes_per_8_pixels`.
pub(crate) fn load_of(
    path: &Path,
    listing: Listing,
    bytes_per_8_pixels: u64,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Imported, ReadSourceError> {
    let Listing {
        train,
        test,
        time_frames,
        duration_s,
        metric,
        tracks,
    } = listing;
    if train.is_empty() {
        return Err(
            SourceErrorCause::missing("every frame of the training video", "give a source with frames").at(path),
        );
    }
    if let Some(tracks) = tracks.as_ref().filter(|t| t.frames() != train.len()) {
        let what = format!(
            "tracks of {} frames where {} were expected",
            tracks.frames(),
            train.len()
        );
        return Err(SourceErrorCause::bad(what, "give tracks of the same clip").at(path));
    }
    check_memory(&train, &test, bytes_per_8_pixels, options).map_err(|e| e.at(path))?;
    let capture = |frames: Vec<ListedFrame>, phase, tracks: Option<Tracks>| -> Result<Capture, ReadSourceError> {
        Ok(Capture {
            frames: decode(path, &frames, time_frames, phase, progress)?,
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

fn check_memory(
    train: &[ListedFrame],
    test: &[ListedFrame],
    bytes_per_8_pixels: u64,
    options: &ImportOptions,
) -> Result<(), SourceErrorCause> {
    let pixels = |f: &ListedFrame| (f.lens.intrinsics.width as u64).saturating_mul(f.lens.intrinsics.height as u64);
    let total = train.iter().chain(test).map(pixels).fold(0u64, u64::saturating_add);
    let needed_bytes = total.saturating_mul(bytes_per_8_pixels).div_ceil(8);
    if needed_bytes <= options.max_memory_bytes {
        return Ok(());
    }
    Err(SourceErrorCause::TooLarge {
        what: format!("a clip of {} frames", train.len() + test.len()),
        needed_bytes,
        limit_bytes: options.max_memory_bytes,
    })
}

fn decode(
    path: &Path,
    frames: &[ListedFrame],
    time_frames: usize,
    phase: &str,
    progress: &dyn Progress,
) -> Result<Vec<CaptureFrame>, ReadSourceError> {
    let done = AtomicUsize::new(0);
    let decoded: Vec<Result<CaptureFrame, ReadSourceError>> = frames
        .par_iter()
        .enumerate()
        .map(|(i, frame)| {
            if progress.cancelled() {
                return Err(SourceErrorCause::Cancelled.at(path));
            }
            let out = one(frame, time_frames).map_err(|e| e.within(path, format!("frame {i} ({})", frame.name)));
            progress.update(phase, done.fetch_add(1, Ordering::Relaxed) + 1, frames.len(), "");
            out
        })
        .collect();
    decoded.into_iter().collect()
}

fn one(frame: &ListedFrame, time_frames: usize) -> Result<CaptureFrame, SourceErrorCause> {
    frame
        .lens
        .check()
        .map_err(|what| SourceErrorCause::bad(what, "correct the camera in the source"))?;
    let last = time_frames.max(1) as f64 - 1.0;
    if !(0.0..=last).contains(&frame.t) {
        let what = format!("its time is {}; 0 to {last} frames were expected", frame.t);
        return Err(SourceErrorCause::bad(what, "correct the times in the source"));
    }
    if !frame.c2w.matrix().iter().all(|v| v.is_finite()) {
        return Err(SourceErrorCause::bad(
            "its pose holds a NaN or infinite value",
            "correct the pose in the source",
        ));
    }
    let get = |e: String| SourceErrorCause::unsupported(e, "undistort the images with the tool that made them");
    let undistort = Undistort::new(&frame.lens).map_err(get)?;
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
    })
}

/// Says that the `i`th of `n` steps of a loop begins, or stops it.
pub(crate) fn step(phase: &str, i: usize, n: usize, progress: &dyn Progress) -> Result<(), SourceErrorCause> {
    if progress.cancelled() {
        return Err(SourceErrorCause::Cancelled);
    }
    progress.update(phase, i + 1, n, "");
    Ok(())
}

fn got<T>(source: &Option<super::FrameSource<T>>) -> Result<Option<T>, SourceErrorCause> {
    source.as_ref().map(super::FrameSource::get).transpose()
}
