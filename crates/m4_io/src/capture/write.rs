//! Writes a [`Capture`] as a folder of posed frames.

use super::{Axes, Split, WriteCaptureError};
use crate::dataset::nerfstudio::{Frame, LensKeys, Transforms, rows};
use crate::{atomic, image, tracks};
use m4_core::{Capture, CaptureFrame, Progress};
use rayon::prelude::*;
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Steps that the nearest percent of all depths should have at least: rounding then costs at most
/// 0.25 % of the depth.
const MIN_STEPS: f64 = 200.0;
/// Steps of a 16-bit depth map.
const MAX_STEPS: f64 = 65535.0;

/// Writes one split of a capture to `folder` in the layout of [the module](super): images, masks
/// and depth as PNG, so that colours and masks come back bit by bit and poses too.
///
/// The list of frames is removed first and written last: a folder that was left half-way is not
/// taken for a capture. `progress` hears of depths that 16 bits cannot hold.
///
/// # Errors
///
/// [`WriteCaptureError`] when the file system refuses, a pose or time is NaN, or the caller
/// asked to stop.
pub fn write(folder: &Path, capture: &Capture, split: Split, progress: &dyn Progress) -> Result<(), WriteCaptureError> {
    let list = folder.join(split.file_name());
    let io = |source| WriteCaptureError::Io {
        path: list.clone(),
        source,
    };
    if let Some(tracks) = capture.tracks.as_ref().filter(|t| t.frames() != capture.frames.len()) {
        return Err(WriteCaptureError::Tracks {
            path: list,
            frames: capture.frames.len(),
            tracks: tracks.frames(),
        });
    }
    let unit = depth_unit(capture);
    let frames = capture
        .frames
        .iter()
        .enumerate()
        .map(|(i, frame)| entry(&list, split, capture.time_frames, i, frame))
        .collect::<Result<Vec<Frame>, _>>()?;
    match fs::remove_file(&list) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(io(e)),
        _ => {}
    }
    let done = AtomicUsize::new(0);
    let total = capture.frames.len();
    let written: Vec<Result<usize, WriteCaptureError>> = capture
        .frames
        .par_iter()
        .zip(&frames)
        .map(|(frame, entry)| {
            if progress.cancelled() {
                return Err(WriteCaptureError::Cancelled { path: list.clone() });
            }
            let clipped = images(folder, frame, entry, unit)?;
            progress.update("write frames", done.fetch_add(1, Ordering::Relaxed) + 1, total, "");
            if let (Some(path), Some(motion)) = (&entry.motion_path, &frame.motion) {
                image::write_grey(&folder.join(path), motion)?;
            }
            if let (Some(path), Some(ids)) = (&entry.instance_path, &frame.instances) {
                image::write_ids(&folder.join(path), ids)?;
            }
            Ok(clipped)
        })
        .collect();
    let clipped: usize = written.into_iter().collect::<Result<Vec<_>, _>>()?.into_iter().sum();
    if clipped > 0 {
        progress.warn(&format!(
            "{clipped} depths above {:.3} were written as that depth: 16 bits hold no more without losing what is near",
            MAX_STEPS * unit
        ));
    }

    let tracks_path = capture.tracks.as_ref().map(|_| split.tracks_file().to_owned());
    if let (Some(name), Some(tracks)) = (&tracks_path, &capture.tracks) {
        let path = folder.join(name);
        tracks::write(&path, tracks).map_err(|source| WriteCaptureError::Io { path, source })?;
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
        time_frames: (split == Split::Test).then_some(capture.time_frames),
        tracks_path,
        frames,
        ..Transforms::default()
    };
    let text = serde_json::to_vec_pretty(&transforms).map_err(|e| io(e.into()))?;
    atomic::write(&list, &text).map_err(io)
}

/// The keys of one frame.
fn entry(
    list: &Path,
    split: Split,
    time_frames: usize,
    index: usize,
    frame: &CaptureFrame,
) -> Result<Frame, WriteCaptureError> {
    let bad = |what: String| WriteCaptureError::BadFrame {
        path: list.to_path_buf(),
        frame: index,
        name: frame.name.clone(),
        what,
    };
    let time = frame.t / (time_frames.max(2) - 1) as f64;
    if !(0.0..=1.0).contains(&time) {
        let last = time_frames.max(1) - 1;
        return Err(bad(format!("t = {}; 0 to {last} frames were expected", frame.t)));
    }
    let k = &frame.camera.intrinsics;
    let numbers = [k.fx, k.fy, k.cx, k.cy];
    if !frame.camera.c2w.matrix().iter().chain(&numbers).all(|v| v.is_finite()) {
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
    let [image, depth, mask, motion, instances] = split.folders().map(|folder| format!("{folder}/{index:05}.png"));
    Ok(Frame {
        file_path: image,
        depth_file_path: frame.depth.as_ref().map(|_| depth),
        mask_path: frame.mask.as_ref().map(|_| mask),
        motion_path: frame.motion.as_ref().map(|_| motion),
        instance_path: frame.instances.as_ref().map(|_| instances),
        time: Some(time),
        camera: frame.camera_index,
        lens: LensKeys::pinhole(k),
        transform_matrix: Some(rows(&frame.camera.c2w)),
    })
}

/// Writes what belongs to one frame; how many depths were too far.
fn images(folder: &Path, frame: &CaptureFrame, entry: &Frame, unit: f64) -> Result<usize, WriteCaptureError> {
    image::write_rgb(&folder.join(&entry.file_path), &frame.rgb)?;
    let mut clipped = 0;
    if let (Some(path), Some(depth)) = (&entry.depth_file_path, &frame.depth) {
        let depth = depth.to_map();
        image::write_depth(&folder.join(path), &depth, unit)?;
        let limit = (MAX_STEPS + 0.5) * unit;
        clipped = depth.data().iter().filter(|&&z| f64::from(z) > limit).count();
    }
    if let (Some(path), Some(mask)) = (&entry.mask_path, &frame.mask) {
        image::write_mask(&folder.join(path), &mask.to_mask())?;
    }
    Ok(clipped)
}

/// Scene units per step of the depth maps that [`write()`] makes: the finest with which the farthest depth fits, unless the near would become
/// coarse; then the far is clipped.
pub fn depth_unit(capture: &Capture) -> f64 {
    let mut known: Vec<f32> = capture
        .frames
        .iter()
        .filter_map(|f| f.depth.as_ref())
        // Every 16th pixel is plenty for a percentile; the maximum is taken over all of them below.
        .flat_map(|d| d.every(16))
        .filter(|z| z.is_finite() && *z > 0.0)
        .collect();
    let farthest = capture
        .frames
        .iter()
        .filter_map(|f| f.depth.as_ref())
        .flat_map(|d| d.every(1))
        .filter(|z| z.is_finite())
        .fold(0.0f32, f32::max);
    if known.is_empty() || farthest <= 0.0 {
        return 1e-3;
    }
    known.sort_by(f32::total_cmp);
    let near = f64::from(known[known.len() / 100]);
    (f64::from(farthest) / MAX_STEPS).min(near / MIN_STEPS)
}
