//! Writes images, masks and depth of frames as PNG, and reads them back.

use super::WriteCaptureAsError;
use crate::image;
use crate::scene::WriteFileError;
use m4_core::{CaptureFrame, Plane, Progress};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Steps of a 16-bit depth map.
const MAX_STEPS: f64 = 65535.0;

/// The files of a frame in a folder; `None` for those that are not written.
pub(in crate::dataset) struct FramePaths {
    pub image: String,
    pub mask: Option<String>,
    pub depth: Option<String>,
}

/// Writes the files of `frames` into `folder`, in parallel; depth in steps of `unit`. Returns how many depths were too far for 16 bits.
pub(in crate::dataset) fn write(
    folder: &Path,
    out: &Path,
    frames: &[(&CaptureFrame, FramePaths)],
    unit: f64,
    progress: &dyn Progress,
) -> Result<usize, WriteCaptureAsError> {
    let (done, total) = (AtomicUsize::new(0), frames.len());
    let each = |(frame, paths): &(&CaptureFrame, FramePaths)| {
        if progress.cancelled() {
            return Err(WriteCaptureAsError::Cancelled {
                path: out.to_path_buf(),
            });
        }
        let clipped = one(folder, frame, paths, unit)?;
        progress.update("write frames", done.fetch_add(1, Ordering::Relaxed) + 1, total, "");
        Ok(clipped)
    };
    let clipped: Vec<usize> = frames.par_iter().map(each).collect::<Result<_, _>>()?;
    Ok(clipped.into_iter().sum())
}

fn one(folder: &Path, frame: &CaptureFrame, paths: &FramePaths, unit: f64) -> Result<usize, WriteCaptureAsError> {
    let differs = |path: PathBuf| WriteFileError::verify(&path, "its pixels differ");
    let path = folder.join(&paths.image);
    image::write_rgb(&path, &frame.rgb)?;
    if image::read_rgb(&path)? != frame.rgb {
        return Err(differs(path).into());
    }
    if let (Some(name), Some(mask)) = (&paths.mask, &frame.mask) {
        let path = folder.join(name);
        let (w, h) = frame.rgb.size();
        let (mw, mh) = mask.size();
        // their readers expect the size of the image, and white where they train
        let is_static = Plane::from_fn(w, h, |x, y| if mask.at(x * mw / w, y * mh / h) { 0 } else { 255 });
        image::write_mask(&path, &is_static)?;
        if image::read_mask(&path)?.to_mask() != is_static {
            return Err(differs(path).into());
        }
    }
    let (Some(name), Some(depth)) = (&paths.depth, &frame.depth) else {
        return Ok(0);
    };
    let path = folder.join(name);
    let (w, h) = frame.rgb.size();
    let (dw, dh) = depth.size();
    let depth = Plane::from_fn(w, h, |x, y| {
        Some(depth.at(x * dw / w, y * dh / h))
            .filter(|z| z.is_finite())
            .unwrap_or(0.0)
    });
    image::write_depth(&path, &depth, unit)?;
    let limit = (MAX_STEPS + 0.5) * unit;
    let back = image::read_depth(&path, unit)?;
    let close = |(i, &z): (usize, &f32)| {
        // a known depth is a step at least
        let z = if z > 0.0 {
            f64::from(z).clamp(unit, MAX_STEPS * unit)
        } else {
            0.0
        };
        (f64::from(back.at(i % w, i / w)) - z).abs() <= 0.51 * unit + 1e-6 * z
    };
    if back.size() != (w, h) || !depth.data().iter().enumerate().all(close) {
        return Err(differs(path).into());
    }
    Ok(depth.data().iter().filter(|&&z| f64::from(z) > limit).count())
}
