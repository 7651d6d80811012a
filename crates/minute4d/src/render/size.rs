//! Cameras for images of another size.

use crate::Refusal;
use m4_core::Intrinsics;

/// Longest side of an image, pixels.
pub const MAX_SIDE_PX: usize = 16_384;

/// Treatment of a different aspect ratio.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Fit {
    /// The middle of the view fills the image; the rest is cut off.
    #[default]
    Crop,
    /// All of the view is in the image, and beside it what lies beyond.
    Extend,
}

/// The same view on an image of `width` x `height` pixels: pixels keep their shape, the middle of the
/// image stays the middle, and the principal point moves with it.
///
/// # Errors
///
/// A refusal of images that are too small or too large.
pub fn fitted(k: &Intrinsics, (width, height): (usize, usize), fit: Fit) -> Result<Intrinsics, Refusal> {
    let fits = |side: usize| (1..=MAX_SIDE_PX).contains(&side);
    if !fits(width) || !fits(height) {
        return Err(Refusal::usage(format!(
            "images of {width} x {height} pixels are not supported; each side must have 1 to {MAX_SIDE_PX}"
        )));
    }
    let (w, h) = (width as f64, height as f64);
    let (across, down) = (w / k.width as f64, h / k.height as f64);
    let scale = match fit {
        Fit::Crop => across.max(down),
        Fit::Extend => across.min(down),
    };
    Ok(Intrinsics {
        width,
        height,
        fx: k.fx * scale,
        fy: k.fy * scale,
        cx: 0.5 * w + (k.cx - 0.5 * k.width as f64) * scale,
        cy: 0.5 * h + (k.cy - 0.5 * k.height as f64) * scale,
    })
}

/// The same image with everything `factor` times as large about the principal point.
#[must_use]
pub fn zoomed(k: &Intrinsics, factor: f64) -> Intrinsics {
    Intrinsics { fx: k.fx * factor, fy: k.fy * factor, ..*k }
}

#[cfg(test)]
mod tests {
    use super::{Fit, fitted};
    use m4_core::Intrinsics;

    const K: Intrinsics = Intrinsics { width: 480, height: 360, fx: 400.0, fy: 410.0, cx: 250.0, cy: 170.0 };

    #[test]
    fn fitting_keeps_the_ray_through_the_image_centre() {
        // The ray through the middle of the image, whatever the size.
        let middle = |k: &Intrinsics| {
            let (w, h) = (k.width as f64, k.height as f64);
            ((0.5 * w - k.cx) / k.fx, (0.5 * h - k.cy) / k.fy)
        };
        for size in [(960, 720), (333, 111), (111, 333), (481, 361)] {
            for fit in [Fit::Crop, Fit::Extend] {
                let got = fitted(&K, size, fit).unwrap();
                let ((a, b), (c, d)) = (middle(&K), middle(&got));
                assert!((a - c).abs() < 1e-12 && (b - d).abs() < 1e-12, "{size:?} {fit:?}");
                assert!((got.fx / got.fy - K.fx / K.fy).abs() < 1e-12);
            }
        }
        assert_eq!(fitted(&K, (960, 720), Fit::Crop).unwrap(), K.resized(960, 720));
    }

    #[test]
    fn a_crop_shows_less_and_an_extension_more() {
        // A square out of 4:3: cropped, it has the height of the view; extended, its width.
        let crop = fitted(&K, (360, 360), Fit::Crop).unwrap();
        assert_eq!((crop.fx, crop.cx, crop.cy), (400.0, 190.0, 170.0));
        let extended = fitted(&K, (480, 480), Fit::Extend).unwrap();
        assert_eq!((extended.fx, extended.cx, extended.cy), (400.0, 250.0, 230.0));
        assert!(fitted(&K, (0, 9), Fit::Crop).is_err() && fitted(&K, (9, 20_000), Fit::Crop).is_err());
    }
}
