//! Sizes of pictures, compared with what their files can hold.

use crate::core::SourceFault;
use m4_io::image;
use m4_scene::{CompactDepth, Intrinsics, Plane};
use std::path::Path;

/// Pixels that a byte of a packed picture can stand for at most: deflate makes 1032 bytes of one, JPEG about 400 pixels.
const PIXELS_A_BYTE: u64 = 1032;
/// Pixels that are always read.
const FREE_PIXELS: u64 = 1 << 20;

/// Whether a packed picture of `file_bytes` can have that size.
pub(crate) fn check_pixels(width: usize, height: usize, file_bytes: u64) -> Result<(), SourceFault> {
    let pixels = (width as u64).saturating_mul(height as u64);
    let most = file_bytes.saturating_mul(PIXELS_A_BYTE).saturating_add(FREE_PIXELS);
    if pixels == 0 || pixels > most {
        let what = format!("{width} x {height} pixels are claimed by {file_bytes} bytes");
        return Err(SourceFault::bad(what, "the file is damaged; export it again"));
    }
    Ok(())
}

/// Width and height of a PNG or JPEG file by its header, compared with the file's length.
pub(crate) fn opened_size(path: &Path) -> Result<(usize, usize), SourceFault> {
    let (width, height) = image::size(path)?;
    check_pixels(width, height, std::fs::metadata(path)?.len())?;
    Ok((width, height))
}

/// The lens of pictures of another size; an error where they are not of the same shape.
pub(crate) fn resized_lens(k: &Intrinsics, (width, height): (usize, usize)) -> Result<Intrinsics, SourceFault> {
    let (sx, sy) = (width as f64 / k.width as f64, height as f64 / k.height as f64);
    // a side is rounded to a whole pixel
    let slack = 1.0 / width.min(height).max(1) as f64 + 1e-9;
    if (sx / sy - 1.0).abs() > slack {
        let what = format!(
            "a picture of {width} x {height} pixels where the camera is of {} x {}",
            k.width, k.height
        );
        let turned = (width > height) != (k.width > k.height);
        let remedy = if turned {
            "the pictures were turned; give them as the sensor saw them"
        } else {
            "give pictures that are not cropped"
        };
        return Err(SourceFault::bad(what, remedy));
    }
    Ok(k.resized(width, height))
}

/// Depth where `confidence` of the same size is above 0, unknown elsewhere.
pub(crate) fn kept_where(depth: &CompactDepth, confidence: &Plane<u8>) -> Result<CompactDepth, SourceFault> {
    if depth.size() != confidence.size() {
        let (d, c) = (depth.size(), confidence.size());
        let what = format!(
            "a confidence map of {} x {} pixels for depth of {} x {}",
            c.0, c.1, d.0, d.1
        );
        return Err(SourceFault::bad(what, "export both again"));
    }
    let (w, h) = depth.size();
    let kept = Plane::from_fn(w, h, |x, y| if confidence[(x, y)] > 0 { depth.at(x, y) } else { 0.0 });
    Ok(CompactDepth::from(kept))
}
