//! Pinholes of numbers, and whether they fit pictures of a size.

use crate::core::SourceFault;
use m4_scene::Intrinsics;

/// How far the sides of a picture may be scaled differently: networks round sides to multiples of 14 or 16 pixels.
const ASPECT_WITHIN: f64 = 0.06;

/// The pinhole `fx fy cx cy`, pixels, of pictures of that size.
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

/// The pinhole of a matrix of 9 numbers, row by row, for pictures of that size.
pub(crate) fn of_matrix(k: &[f64], size: (usize, usize)) -> Result<Intrinsics, SourceFault> {
    let bad = || {
        let what = format!("{k:?} is no matrix fx 0 cx 0 fy cy 0 0 1");
        SourceFault::bad(what, "correct the intrinsics in the source")
    };
    let &[fx, skew, cx, zero, fy, cy, a, b, one] = k else {
        return Err(bad());
    };
    let small = |v: f64| v.abs() <= 1e-3 * fx.abs();
    let is_matrix = small(skew) && small(zero) && a == 0.0 && b == 0.0 && (one - 1.0).abs() < 1e-6;
    if !(is_matrix && fx.is_finite() && fx > 0.0 && fy.is_finite() && fy > 0.0 && cx.is_finite() && cy.is_finite()) {
        return Err(bad());
    }
    Ok(pinhole([fx, fy, cx, cy], size))
}

/// The lens of a camera for its pictures at another size: a side is rounded to a whole pixel, nothing is cut off or turned.
pub(crate) fn resized(k: &Intrinsics, (width, height): (usize, usize)) -> Result<Intrinsics, SourceFault> {
    let slack = 1.0 / width.min(height).max(1) as f64 + 1e-9;
    if (aspect(k, (width, height)) - 1.0).abs() > slack {
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

/// The lens that a network computed on pictures of its own size, for the same picture at another: sides are scaled, each for itself.
pub(crate) fn scaled(k: &Intrinsics, (width, height): (usize, usize)) -> Result<Intrinsics, SourceFault> {
    if (aspect(k, (width, height)) - 1.0).abs() > ASPECT_WITHIN {
        let what = format!(
            "the pictures are {width} x {height}, of another shape than the {} x {} that the cameras were computed on",
            k.width, k.height
        );
        return Err(SourceFault::bad(what, "give the pictures as the tool saw them"));
    }
    Ok(k.resized(width, height))
}

/// By how much more the width is scaled than the height.
fn aspect(k: &Intrinsics, (width, height): (usize, usize)) -> f64 {
    (width as f64 / k.width as f64) / (height as f64 / k.height as f64)
}
