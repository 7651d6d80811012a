//! The best shift of a region: how far beside its place something was drawn, and how good a copy it
//! is otherwise.

use super::metric::{ImageError, MAX_PSNR_DB, same_size};
use m4_core::RgbImage;

/// Largest shift along an axis, share of the image width.
const REACH: f64 = 0.05;
/// Pixels of the region that are compared in the search, spread evenly, at most.
const SEARCHED: usize = 4000;

/// A region of an image compared with the reference as it lies and after its best shift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shift {
    /// Columns and rows by which the image is shifted for the best agreement, whole pixels.
    pub by_px: [i32; 2],
    /// PSNR over the region without a shift, dB.
    pub placed_db: f64,
    /// PSNR over the region after it, dB.
    pub aligned_db: f64,
}

/// Finds the shift of `image` with the least squared error over `region`, pixels of `reference`,
/// among all whole ones of up to 5 % of the width along each axis; of a large region, over pixels
/// spread evenly. Outside the image its rim is repeated. `None` if the region is empty.
///
/// # Errors
///
/// [`ImageError`] if the sizes differ.
pub fn best_shift(
    image: &RgbImage,
    reference: &RgbImage,
    region: &[(usize, usize)],
) -> Result<Option<Shift>, ImageError> {
    same_size("the image", reference.size(), image.size())?;
    if region.is_empty() {
        return Ok(None);
    }
    let (w, h) = image.size();
    let error = |dx: i32, dy: i32, step: usize| -> u64 {
        let clamped =
            |i: usize, d: i32, n: usize| (i as i64 - i64::from(d)).clamp(0, n as i64 - 1) as usize;
        let squared = |&(x, y): &(usize, usize)| {
            let (a, b) = (
                image[(clamped(x, dx, w), clamped(y, dy, h))],
                reference[(x, y)],
            );
            (0..3)
                .map(|c| u64::from(a[c].abs_diff(b[c])).pow(2))
                .sum::<u64>()
        };
        region.iter().step_by(step).map(squared).sum()
    };
    let (reach, step) = (
        (REACH * w as f64).ceil() as i32,
        region.len().div_ceil(SEARCHED),
    );
    let shifts = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)));
    // of equal ones the shortest
    let best = shifts
        .min_by_key(|&(dx, dy)| (error(dx, dy, step), dx * dx + dy * dy))
        .unwrap_or_default();
    let (placed, aligned) = (error(0, 0, 1), error(best.0, best.1, 1));
    let psnr = |sum: u64| {
        let mse = sum as f64 / (3.0 * 255.0 * 255.0 * region.len() as f64);
        (-10.0 * mse.log10()).min(MAX_PSNR_DB)
    };
    Ok(Some(Shift {
        by_px: [best.0, best.1],
        placed_db: psnr(placed),
        aligned_db: psnr(aligned),
    }))
}

#[cfg(test)]
mod tests {
    use super::best_shift;
    use m4_core::{Plane, RgbImage};

    fn texture(dx: usize, dy: usize) -> RgbImage {
        let value = |x: usize, y: usize| {
            (128.0 + 100.0 * (x as f32 * 0.09).sin() * (y as f32 * 0.07 + x as f32 * 0.02).cos())
                as u8
        };
        Plane::from_fn(200, 100, |x, y| [value(x + dx, y + dy), 90, 30])
    }

    #[test]
    fn a_shift_is_found_with_its_sign_and_undone() {
        let region: Vec<_> = (30..60)
            .flat_map(|y| (80..120).map(move |x| (x, y)))
            .collect();
        // what the reference shows at (x, y) the image shows at (x - 5, y - 4)
        let actual = best_shift(&texture(5, 4), &texture(0, 0), &region)
            .unwrap()
            .unwrap();
        assert_eq!(actual.by_px, [5, 4]);
        assert!(
            actual.aligned_db == super::MAX_PSNR_DB && actual.placed_db < 30.0,
            "{actual:?}"
        );
        let none = best_shift(&texture(0, 0), &texture(0, 0), &region)
            .unwrap()
            .unwrap();
        assert_eq!((none.by_px, none.placed_db), ([0, 0], none.aligned_db));
        assert_eq!(
            best_shift(&texture(0, 0), &texture(0, 0), &[]).unwrap(),
            None
        );
        assert!(best_shift(&texture(0, 0), &Plane::filled(9, 9, [0; 3]), &region).is_err());
    }
}
