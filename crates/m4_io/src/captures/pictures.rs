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

/// Where the files of a frame lie in a folder; `None` for what is not written.
pub(super) struct Places {
    pub picture: String,
    pub mask: Option<String>,
    pub depth: Option<String>,
}

/// Writes the files of `frames` into `folder`, in parallel; depth in steps of `unit`. Says how many depths were too far for 16 bits.
pub(super) fn write(
    folder: &Path,
    out: &Path,
    frames: &[(&CaptureFrame, Places)],
    unit: f64,
    progress: &dyn Progress,
) -> Result<usize, WriteCaptureAsError> {
    let (done, total) = (AtomicUsize::new(0), frames.len());
    let each = |(frame, places): &(&CaptureFrame, Places)| {
        if progress.cancelled() {
            return Err(WriteCaptureAsError::Cancelled {
                path: out.to_path_buf(),
            });
        }
        let clipped = one(folder, frame, places, unit)?;
        progress.update("write frames", done.fetch_add(1, Ordering::Relaxed) + 1, total, "");
        Ok(clipped)
    };
    let clipped: Vec<usize> = frames.par_iter().map(each).collect::<Result<_, _>>()?;
    Ok(clipped.into_iter().sum())
}

fn one(folder: &Path, frame: &CaptureFrame, places: &Places, unit: f64) -> Result<usize, WriteCaptureAsError> {
    let otherwise = |path: PathBuf| WriteFileError::verify(&path, "its pixels are others");
    let path = folder.join(&places.picture);
    image::write_rgb(&path, &frame.rgb)?;
    if image::read_rgb(&path)? != frame.rgb {
        return Err(otherwise(path).into());
    }
    if let (Some(place), Some(mask)) = (&places.mask, &frame.mask) {
        let path = folder.join(place);
        let (w, h) = frame.rgb.size();
        let (mw, mh) = mask.size();
        // their readers want the size of the image, and white where they may look
        let rests = Plane::from_fn(w, h, |x, y| if mask.at(x * mw / w, y * mh / h) { 0 } else { 255 });
        image::write_mask(&path, &rests)?;
        if image::read_mask(&path)?.to_mask() != rests {
            return Err(otherwise(path).into());
        }
    }
    let (Some(place), Some(depth)) = (&places.depth, &frame.depth) else {
        return Ok(0);
    };
    let path = folder.join(place);
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
        return Err(otherwise(path).into());
    }
    Ok(depth.data().iter().filter(|&&z| f64::from(z) > limit).count())
}
