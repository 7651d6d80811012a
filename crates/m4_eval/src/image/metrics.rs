//! PSNR, the SSIM map, and the dilation of masks.

use super::{ImageError, Picture};
use m4_scene::{Mask, Plane};

/// Side of the SSIM window, pixels.
pub const SSIM_WINDOW_PX: usize = 11;
/// Standard deviation of the SSIM window, pixels.
pub const SSIM_SIGMA_PX: f64 = 1.5;
/// What identical pictures score, dB: the true value is infinite, which no table can average.
pub const MAX_PSNR_DB: f64 = 100.0;

const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

pub(super) fn same_size(what: &'static str, expected: (usize, usize), found: (usize, usize)) -> Result<(), ImageError> {
    if expected == found {
        Ok(())
    } else {
        Err(ImageError::Size { what, expected, found })
    }
}

/// Peak signal-to-noise ratio in dB, joint over the channels, at most [`MAX_PSNR_DB`]; over the pixels
/// where `mask` is not 0, or all of them. `None` if there is no such pixel.
///
/// # Errors
///
/// [`ImageError::Size`] if the sizes differ.
pub fn psnr_db(image: &Picture, reference: &Picture, mask: Option<&Mask>) -> Result<Option<f64>, ImageError> {
    same_size("the picture", reference.size(), image.size())?;
    if let Some(mask) = mask {
        same_size("the mask", reference.size(), mask.size())?;
    }
    let inside = |i: usize| mask.is_none_or(|m| m.data()[i] != 0);
    let (mut sum, mut count) = (0.0f64, 0usize);
    for (a, b) in image.planes().iter().zip(reference.planes()) {
        for (i, (a, b)) in a.iter().zip(b).enumerate().filter(|&(i, _)| inside(i)) {
            debug_assert!(i < reference.width() * reference.height());
            let d = f64::from(a - b);
            sum += d * d;
            count += 1;
        }
    }
    let psnr = |mse: f64| (-10.0 * mse.log10()).min(MAX_PSNR_DB);
    Ok((count > 0).then(|| psnr(sum / count as f64)))
}

/// The structural similarity around each pixel of the valid region, mean of the channels.
#[derive(Debug, Clone, PartialEq)]
pub struct SsimMap {
    /// `[height - 10][width - 10]`: entry `(x, y)` belongs to pixel `(x + 5, y + 5)`.
    pub map: Plane<f64>,
}

impl SsimMap {
    /// Mean over the valid region.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.map.data().iter().sum::<f64>() / self.map.data().len() as f64
    }

    /// Mean over those pixels of `mask` (as large as the pictures) that lie in the valid region;
    /// `None` if there are none.
    #[must_use]
    pub fn mean_inside(&self, mask: &Mask) -> Option<f64> {
        let border = SSIM_WINDOW_PX / 2;
        let (mut sum, mut count) = (0.0, 0usize);
        for y in 0..self.map.height().min(mask.height().saturating_sub(border)) {
            for x in 0..self.map.width().min(mask.width().saturating_sub(border)) {
                if mask[(x + border, y + border)] != 0 {
                    sum += self.map[(x, y)];
                    count += 1;
                }
            }
        }
        (count > 0).then(|| sum / count as f64)
    }
}

/// The SSIM map of two pictures (Wang et al. 2004, equation 13).
///
/// # Errors
///
/// [`ImageError::Size`] if the sizes differ, [`ImageError::TooSmall`] if no window fits.
pub fn ssim_map(image: &Picture, reference: &Picture) -> Result<SsimMap, ImageError> {
    same_size("the picture", reference.size(), image.size())?;
    let (width, height) = reference.size();
    if width < SSIM_WINDOW_PX || height < SSIM_WINDOW_PX {
        return Err(ImageError::TooSmall {
            width,
            height,
            window: SSIM_WINDOW_PX,
        });
    }
    let window = gaussian_window();
    let (out_w, out_h) = (width + 1 - SSIM_WINDOW_PX, height + 1 - SSIM_WINDOW_PX);
    let mut sum = vec![0.0; out_w * out_h];
    for (a, b) in image.planes().iter().zip(reference.planes()) {
        let blur = |f: &dyn Fn(f64, f64) -> f64| {
            let values: Vec<f64> = a.iter().zip(b).map(|(&a, &b)| f(f64::from(a), f64::from(b))).collect();
            blur_valid(&values, width, height, &window)
        };
        let (ma, mb) = (blur(&|a, _| a), blur(&|_, b| b));
        let (aa, bb, ab) = (blur(&|a, _| a * a), blur(&|_, b| b * b), blur(&|a, b| a * b));
        for i in 0..sum.len() {
            let (va, vb, cov) = (aa[i] - ma[i] * ma[i], bb[i] - mb[i] * mb[i], ab[i] - ma[i] * mb[i]);
            let means = (2.0 * ma[i] * mb[i] + C1) / (ma[i] * ma[i] + mb[i] * mb[i] + C1);
            sum[i] += means * (2.0 * cov + C2) / (va + vb + C2) / 3.0;
        }
    }
    let map = Plane::from_fn(out_w, out_h, |x, y| sum[y * out_w + x]);
    Ok(SsimMap { map })
}

fn gaussian_window() -> [f64; SSIM_WINDOW_PX] {
    let mut window = [0.0; SSIM_WINDOW_PX];
    for (i, w) in window.iter_mut().enumerate() {
        let d = i as f64 - (SSIM_WINDOW_PX / 2) as f64;
        *w = (-d * d / (2.0 * SSIM_SIGMA_PX * SSIM_SIGMA_PX)).exp();
    }
    let total: f64 = window.iter().sum();
    window.map(|w| w / total)
}

/// Separable convolution without padding: `[height - 10][width - 10]`.
fn blur_valid(values: &[f64], width: usize, height: usize, window: &[f64; SSIM_WINDOW_PX]) -> Vec<f64> {
    let out_w = width + 1 - SSIM_WINDOW_PX;
    let out_h = height + 1 - SSIM_WINDOW_PX;
    let mut rows = vec![0.0; out_w * height];
    for y in 0..height {
        let source = &values[y * width..(y + 1) * width];
        let target = &mut rows[y * out_w..(y + 1) * out_w];
        for (k, &w) in window.iter().enumerate() {
            for (t, s) in target.iter_mut().zip(&source[k..]) {
                *t += w * s;
            }
        }
    }
    let mut out = vec![0.0; out_w * out_h];
    for y in 0..out_h {
        let target = &mut out[y * out_w..(y + 1) * out_w];
        for (k, &w) in window.iter().enumerate() {
            let source = &rows[(y + k) * out_w..(y + k + 1) * out_w];
            for (t, s) in target.iter_mut().zip(source) {
                *t += w * s;
            }
        }
    }
    out
}

/// The mask grown by `radius_px` in every direction (a square of side `2 radius + 1`).
#[must_use]
pub fn dilated(mask: &Mask, radius_px: usize) -> Mask {
    let (width, height) = mask.size();
    let reach = |i: usize, n: usize| i.saturating_sub(radius_px)..(i + radius_px + 1).min(n);
    let rows = Plane::from_fn(width, height, |x, y| {
        reach(x, width).map(|x| mask[(x, y)]).max().unwrap_or(0)
    });
    Plane::from_fn(width, height, |x, y| {
        reach(y, height).map(|y| rows[(x, y)]).max().unwrap_or(0)
    })
}

#[cfg(test)]
mod tests {
    use super::{MAX_PSNR_DB, Picture, dilated, psnr_db, ssim_map};
    use crate::image::ImageError;
    use m4_scene::Plane;

    fn flat(width: usize, height: usize, value: f32) -> Picture {
        let plane = vec![value; width * height];
        Picture::from_planes(width, height, [&plane, &plane, &plane]).unwrap()
    }

    #[test]
    fn psnr_of_a_constant_offset_is_its_logarithm() {
        let (a, b) = (flat(16, 12, 0.5), flat(16, 12, 0.6));
        let got = psnr_db(&a, &b, None).unwrap().unwrap();
        assert!((got - 20.0).abs() < 1e-5, "{got}");
        assert_eq!(psnr_db(&a, &a, None).unwrap(), Some(MAX_PSNR_DB));
    }

    #[test]
    fn psnr_is_joint_over_channels_and_clamps() {
        // One channel off by 0.3, another above the range: mean squared error 0.09 / 3.
        let (zero, one, over) = (vec![0.0; 4], vec![1.0; 4], vec![7.0; 4]);
        let third = vec![0.3; 4];
        let a = Picture::from_planes(2, 2, [&third, &over, &zero]).unwrap();
        let b = Picture::from_planes(2, 2, [&zero, &one, &zero]).unwrap();
        let got = psnr_db(&a, &b, None).unwrap().unwrap();
        assert!((got + 10.0 * 0.03f64.log10()).abs() < 1e-5, "{got}");
    }

    #[test]
    fn a_mask_selects_pixels() {
        let reference = flat(20, 20, 0.5);
        let plane: Vec<f32> = (0..400).map(|i| if i % 20 < 10 { 0.6 } else { 0.5 }).collect();
        let image = Picture::from_planes(20, 20, [&plane, &plane, &plane]).unwrap();
        let left = Plane::from_fn(20, 20, |x, _| if x < 10 { 255 } else { 0 });
        let right = left.map(|&m| 255 - m);
        let db = |mask| psnr_db(&image, &reference, Some(mask)).unwrap();
        assert!((db(&left).unwrap() - 20.0).abs() < 1e-5);
        assert_eq!(db(&right), Some(MAX_PSNR_DB));
        assert_eq!(db(&Plane::filled(20, 20, 0)), None);
        let map = ssim_map(&image, &reference).unwrap();
        // Windows that reach at most to column 15 + 5 from the step see only equal pixels.
        let far = Plane::from_fn(20, 20, |x, _| if x >= 15 { 255 } else { 0 });
        assert!(map.mean_inside(&far).is_none());
        let inner = Plane::from_fn(20, 20, |x, _| if x == 10 { 255 } else { 0 });
        let (inside, all) = (map.mean_inside(&inner).unwrap(), map.mean());
        assert!(inside < all && all < 1.0, "{inside} {all}");
    }

    #[test]
    fn ssim_of_flat_pictures_is_the_luminance_term() {
        let (a, b) = (flat(15, 13, 0.2), flat(15, 13, 0.6));
        let map = ssim_map(&a, &b).unwrap();
        assert_eq!(map.map.size(), (5, 3));
        let want = (2.0 * 0.2 * 0.6 + 1e-4) / (0.2 * 0.2 + 0.6 * 0.6 + 1e-4);
        assert!(
            (map.mean() - want).abs() < 1e-6,
            "{} where {want} was expected",
            map.mean()
        );
        assert!((ssim_map(&a, &a).unwrap().mean() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn ssim_of_scaled_contrast_has_a_closed_form() {
        // b = a scaled about its local mean by -1 where the mean is the same everywhere: a checkerboard
        // has window mean 0.5 + e and variance s^2; its negative has mean 0.5 - e and covariance -s^2.
        let a: Vec<f32> = (0..400)
            .map(|i| if (i % 20 + i / 20) % 2 == 0 { 0.75 } else { 0.25 })
            .collect();
        let b: Vec<f32> = a.iter().map(|v| 1.0 - v).collect();
        let (a, b) = (
            Picture::from_planes(20, 20, [&a, &a, &a]).unwrap(),
            Picture::from_planes(20, 20, [&b, &b, &b]).unwrap(),
        );
        // Alternating Gaussian sum of an 11 tap window with sd 1.5, squared: below 1e-4, so e is nothing.
        let got = ssim_map(&a, &b).unwrap().mean();
        let want = (-2.0 * 0.0625 + 9e-4) / (2.0 * 0.0625 + 9e-4);
        assert!((got - want).abs() < 1e-3, "{got} where {want} was expected");
    }

    #[test]
    fn dilation_grows_a_square() {
        let dot = Plane::from_fn(9, 9, |x, y| if (x, y) == (4, 1) { 255 } else { 0 });
        let grown = dilated(&dot, 2);
        let count = grown.data().iter().filter(|&&m| m == 255).count();
        assert_eq!(count, 5 * 4);
        assert_eq!(dilated(&dot, 0), dot);
    }

    #[test]
    fn bad_input_is_named() {
        let (a, b) = (flat(16, 16, 0.5), flat(12, 16, 0.5));
        assert!(matches!(psnr_db(&a, &b, None), Err(ImageError::Size { .. })));
        assert!(matches!(
            psnr_db(&a, &a, Some(&Plane::filled(3, 3, 255))),
            Err(ImageError::Size { .. })
        ));
        assert!(matches!(
            ssim_map(&flat(10, 20, 0.0), &flat(10, 20, 0.0)),
            Err(ImageError::TooSmall { .. })
        ));
        let (good, bad, short) = (vec![0.0; 4], vec![0.0, f32::NAN, 0.0, 0.0], vec![0.0; 3]);
        let nan = Picture::from_planes(2, 2, [&good, &bad, &good]);
        assert!(matches!(
            nan,
            Err(ImageError::NotFinite {
                x: 1,
                y: 0,
                channel: 1,
                ..
            })
        ));
        assert!(matches!(
            Picture::from_planes(2, 2, [&good, &good, &short]),
            Err(ImageError::Length {
                channel: 2,
                found: 3,
                ..
            })
        ));
    }
}
