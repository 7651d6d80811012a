//! Resizes images.

use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::U8x3;
use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions, Resizer};
use m4_core::{Plane, RgbImage};

/// The image at `width` x `height` pixels, filtered against aliasing: shrinking weighs every
/// source pixel with a triangle two target pixels wide (both at least 1 pixel; `None` otherwise).
#[must_use]
pub fn resize_rgb(image: &RgbImage, width: usize, height: usize) -> Option<RgbImage> {
    if image.size() == (width, height) {
        return Some(image.clone());
    }
    let side = |n: usize| u32::try_from(n).ok().filter(|&n| n > 0);
    let pixels: Vec<U8x3> = image.data().iter().map(|&p| U8x3::new(p)).collect();
    let source = TypedImageRef::new(side(image.width())?, side(image.height())?, &pixels).ok()?;
    let mut target = TypedImage::new(side(width)?, side(height)?);
    let options = ResizeOptions::new().resize_alg(ResizeAlg::Convolution(FilterType::Bilinear));
    Resizer::new().resize_typed(&source, &mut target, &options).ok()?;
    Plane::from_vec(width, height, target.pixels().iter().map(|p| p.0).collect()).ok()
}

#[cfg(test)]
mod tests {
    use super::resize_rgb;
    use m4_core::Plane;

    #[test]
    fn shrinking_averages_a_fine_checkerboard() {
        let board = Plane::from_fn(64, 64, |x, y| if (x + y) % 2 == 0 { [255; 3] } else { [0; 3] });
        let small = resize_rgb(&board, 16, 16).unwrap();
        assert_eq!(small.size(), (16, 16));
        assert!(small.data().iter().flatten().all(|v| v.abs_diff(127) <= 2));
    }

    #[test]
    fn resizing_keeps_a_ramp_in_place() {
        // Corner-based coordinates: the middle of target pixel x is source coordinate 4 x + 2.
        let ramp = Plane::from_fn(256, 4, |x, _| [x as u8; 3]);
        let small = resize_rgb(&ramp, 64, 1).unwrap();
        for x in 2..62 {
            let want = 4.0 * x as f64 + 1.5;
            assert!((f64::from(small[(x, 0)][0]) - want).abs() <= 1.0);
        }
        assert!(resize_rgb(&ramp, 0, 4).is_none());
    }
}
