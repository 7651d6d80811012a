//! Parses pinhole intrinsics, and checks that they fit the image size.

use crate::dataset::SourceErrorCause;
use m4_core::Intrinsics;

/// The pinhole `fx fy cx cy`, pixels, of images of that size.
pub(crate) fn pinhole([fx, fy, cx, cy]: [f64; 4], (width, height): (usize, usize)) -> Intrinsics {
    Intrinsics {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
    }
}

/// The lens of a camera for its images at another size: a side is rounded to a whole pixel, nothing is cut off or turned.
pub(crate) fn resized(k: &Intrinsics, (width, height): (usize, usize)) -> Result<Intrinsics, SourceErrorCause> {
    let slack = 1.0 / width.min(height).max(1) as f64 + 1e-9;
    if (aspect(k, (width, height)) - 1.0).abs() > slack {
        let what = format!(
            "an image of {width} x {height} pixels where the camera is of {} x {}",
            k.width, k.height
        );
        let turned = (width > height) != (k.width > k.height);
        let hint = if turned {
            "the images were rotated; use them in the sensor's orientation"
        } else {
            "give images that are not cropped"
        };
        return Err(SourceErrorCause::bad(what, hint));
    }
    Ok(k.resized(width, height))
}

/// By how much more the width is scaled than the height.
fn aspect(k: &Intrinsics, (width, height): (usize, usize)) -> f64 {
    (width as f64 / k.width as f64) / (height as f64 / k.height as f64)
}
