//! Structural similarity (Wang et al. 2004, equation 13), in the variants that papers report.
//!
//! ```text
//! two images --window--> means, variances, covariance around each pixel, a channel
//!   --> (2 ma mb + C1)(2 cov + C2) / ((ma^2 + mb^2 + C1)(va + vb + C2)) --mean of the channels--> map --mean--> SSIM
//! ```
//!
//! `C1 = 0.01^2`, `C2 = 0.03^2` for colours from 0 to 1. Flavours differ in the window, in what
//! lies beyond the border, and in whether variances are of a sample (`n / (n - 1)` times as large):
//! [`SsimKind`]. They differ in the second decimal, so a figure without its flavour says little.

use super::{ImageError, PlanarImage, check_sizes};
use m4_core::{Mask, Plane};
use serde::{Deserialize, Serialize};

const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Variants of structural similarity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SsimKind {
    /// 11x11 Gaussian of 1.5 px, windows that lie wholly inside: Wang et al.'s own. Equals
    /// scikit-image's `structural_similarity` with
    /// `gaussian_weights=True, sigma=1.5, use_sample_covariance=False`.
    GaussianValid,
    /// The same window with zeros beyond the border, every pixel: the SSIM of 3D Gaussian
    /// Splatting's training loss, which many programs report as well. Borders score better than
    /// they should, where black meets black.
    GaussianZeroPadded,
    /// 7x7 window of equal weights, variances of a sample, windows that lie wholly inside:
    /// `structural_similarity` of scikit-image with its defaults (RoDynRF's protocol).
    SkimageUniform,
    /// DyCheck's mSSIM (Gao et al., NeurIPS 2022): 11x11 Gaussian of 1.5 px over the pixels of the
    /// mask alone, whose sums are multiplied by the side of the window over how many of its pixels
    /// are in the mask, along rows and then along columns (the partial convolution of Liu et al.,
    /// ECCV 2018); variances are cut off at 0, the covariance at their geometric mean. The mean
    /// goes over all windows that lie wholly inside the image; one without a pixel of the mask
    /// counts as 1, as its authors' program has it.
    DycheckMasked,
}

impl SsimKind {
    /// Returns the title in a report.
    #[must_use]
    pub fn title(self) -> &'static str {
        match self {
            Self::GaussianValid => "Gaussian 11/1.5, valid region",
            Self::GaussianZeroPadded => "Gaussian 11/1.5, zeros beyond the border",
            Self::SkimageUniform => {
                "uniform 7, sample covariance, valid region (scikit-image's defaults)"
            }
            Self::DycheckMasked => "Gaussian 11/1.5, partial convolution over the mask (DyCheck)",
        }
    }

    fn window(self) -> Window {
        Window {
            taps: if self == Self::SkimageUniform {
                vec![1.0 / 7.0; 7]
            } else {
                Window::gaussian()
            },
            zero_padded: self == Self::GaussianZeroPadded,
            of_sample: self == Self::SkimageUniform,
        }
    }
}

/// The structural similarity around each pixel of the region that counts, mean of the channels.
#[derive(Debug, Clone, PartialEq)]
pub struct SsimMap {
    /// Entry `(x, y)` belongs to pixel `(x + border_px, y + border_px)`.
    pub map: Plane<f64>,
    /// Number of border pixels without an entry, per side.
    pub border_px: usize,
}

impl SsimMap {
    /// Mean over the region.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.map.data().iter().sum::<f64>() / self.map.data().len() as f64
    }

    /// Mean over those pixels of `mask` (as large as the images) that lie in the region; `None` if
    /// there are none.
    #[must_use]
    pub fn mean_inside(&self, mask: &Mask) -> Option<f64> {
        let border = self.border_px;
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

/// The SSIM map of two images. Only [`SsimKind::DycheckMasked`] looks at the mask here (all pixels
/// without one); for the others it selects entries of the map: [`SsimMap::mean_inside`].
///
/// # Errors
///
/// [`ImageError`] if the sizes differ or no window fits.
pub fn ssim_map(
    kind: SsimKind,
    image: &PlanarImage,
    reference: &PlanarImage,
    mask: Option<&Mask>,
) -> Result<SsimMap, ImageError> {
    check_sizes(image, reference, mask)?;
    let (width, height) = reference.size();
    let window = kind.window();
    if width < window.side() || height < window.side() {
        let side = window.side();
        return Err(ImageError(format!(
            "SSIM needs at least {side}x{side} pixels; the image is {width}x{height}"
        )));
    }
    let (out_w, out_h) = window.out_size(width, height);
    let mut sum = vec![0.0; out_w * out_h];
    for (a, b) in image.planes().iter().zip(reference.planes()) {
        let mean = |f: &dyn Fn(f64, f64) -> f64| {
            let values: Vec<f64> = a
                .iter()
                .zip(b)
                .map(|(&a, &b)| f(f64::from(a), f64::from(b)))
                .collect();
            match kind {
                SsimKind::DycheckMasked => filtered(&values, mask, width, height, &window),
                _ => window.filtered(&values, width, height),
            }
        };
        let (ma, mb) = (mean(&|a, _| a), mean(&|_, b| b));
        let (aa, bb, ab) = (
            mean(&|a, _| a * a),
            mean(&|_, b| b * b),
            mean(&|a, b| a * b),
        );
        for i in 0..sum.len() {
            let spread = [
                aa[i] - ma[i] * ma[i],
                bb[i] - mb[i] * mb[i],
                ab[i] - ma[i] * mb[i],
            ];
            let [va, vb, cov] = match kind {
                SsimKind::DycheckMasked => possible(spread),
                _ => spread.map(|v| v * window.unbias()),
            };
            let means = (2.0 * ma[i] * mb[i] + C1) / (ma[i] * ma[i] + mb[i] * mb[i] + C1);
            sum[i] += means * (2.0 * cov + C2) / (va + vb + C2) / 3.0;
        }
    }
    let map = Plane::from_fn(out_w, out_h, |x, y| sum[y * out_w + x]);
    let border_px = (width - out_w) / 2;
    Ok(SsimMap { map, border_px })
}

/// The mean SSIM of two images: over the whole region, or inside `mask`. `None` if no pixel of the
/// mask lies in the region.
///
/// # Errors
///
/// [`ImageError`] if the sizes differ or no window fits.
pub fn ssim(
    kind: SsimKind,
    image: &PlanarImage,
    reference: &PlanarImage,
    mask: Option<&Mask>,
) -> Result<Option<f64>, ImageError> {
    let map = ssim_map(kind, image, reference, mask)?;
    Ok(match mask {
        None => Some(map.mean()),
        Some(mask) if kind == SsimKind::DycheckMasked => {
            mask.data().iter().any(|&m| m != 0).then(|| map.mean())
        }
        Some(mask) => map.mean_inside(mask),
    })
}

/// Weighted means of those `values` `[height][width]` that are in `mask` (all of them without one),
/// where the window lies wholly inside: along rows, then along columns. Each sum is multiplied by
/// the number of taps over how many of them are in the mask, *not* by the weights that are; 0 where
/// none is. After the first pass a place is in the mask if any of its taps was.
fn filtered(
    values: &[f64],
    mask: Option<&Mask>,
    width: usize,
    height: usize,
    window: &Window,
) -> Vec<f64> {
    let (out_w, out_h) = (width + 1 - window.side(), height + 1 - window.side());
    let valid: Vec<bool> = match mask {
        Some(mask) => mask.data().iter().map(|&m| m != 0).collect(),
        None => vec![true; values.len()],
    };
    let (mut rows, mut rows_kept) = (vec![0.0; out_w * height], vec![false; out_w * height]);
    for y in 0..height {
        for x in 0..out_w {
            let taps = y * width + x..y * width + x + window.side();
            (rows[y * out_w + x], rows_kept[y * out_w + x]) =
                mean(taps.map(|i| (values[i], valid[i])), window);
        }
    }
    let mut out = vec![0.0; out_w * out_h];
    for y in 0..out_h {
        for x in 0..out_w {
            let taps = (y..y + window.side()).map(|y| y * out_w + x);
            (out[y * out_w + x], _) = mean(taps.map(|i| (rows[i], rows_kept[i])), window);
        }
    }
    out
}

/// The renormalised sum, and whether anything was in the mask.
fn mean(values: impl Iterator<Item = (f64, bool)>, window: &Window) -> (f64, bool) {
    let (mut sum, mut count) = (0.0, 0usize);
    for ((value, valid), weight) in values.zip(&window.taps) {
        if valid {
            sum += weight * value;
            count += 1;
        }
    }
    if count == 0 {
        return (0.0, false);
    }
    (sum * window.side() as f64 / count as f64, true)
}

/// Variances and covariance as they can be: renormalised means of squares need not be above the
/// squares of means.
fn possible([va, vb, cov]: [f64; 3]) -> [f64; 3] {
    let (va, vb) = (va.max(0.0), vb.max(0.0));
    [va, vb, cov.abs().min((va * vb).sqrt()).copysign(cov)]
}

/// Side of the Gaussian window, pixels.
pub const SSIM_WINDOW_PX: usize = 11;
/// Standard deviation of the Gaussian window, pixels.
pub const SSIM_SIGMA_PX: f64 = 1.5;

/// A square window, the product of the same taps along rows and columns.
struct Window {
    /// An odd number, of sum 1.
    taps: Vec<f64>,
    /// With zeros beyond the border, so that every pixel has a window.
    zero_padded: bool,
    /// Variances are those of a sample of as many pixels as the window has, whatever their weights:
    /// scikit-image's default.
    of_sample: bool,
}

impl Window {
    /// [`SSIM_WINDOW_PX`] taps of a Gaussian of [`SSIM_SIGMA_PX`].
    fn gaussian() -> Vec<f64> {
        let tap = |i: usize| {
            let d = i as f64 - (SSIM_WINDOW_PX / 2) as f64;
            (-d * d / (2.0 * SSIM_SIGMA_PX * SSIM_SIGMA_PX)).exp()
        };
        let taps: Vec<f64> = (0..SSIM_WINDOW_PX).map(tap).collect();
        let total: f64 = taps.iter().sum();
        taps.iter().map(|w| w / total).collect()
    }

    /// Pixels a side.
    fn side(&self) -> usize {
        self.taps.len()
    }

    /// Factor of variances.
    fn unbias(&self) -> f64 {
        let n = (self.side() * self.side()) as f64;
        if self.of_sample { n / (n - 1.0) } else { 1.0 }
    }

    /// Columns and rows that have a window, of images that are as large as one at least.
    fn out_size(&self, width: usize, height: usize) -> (usize, usize) {
        let lost = if self.zero_padded { 0 } else { self.side() - 1 };
        (width - lost, height - lost)
    }

    /// Weighted means of `values` `[height][width]`, in [`Self::out_size`]: along rows, then along
    /// columns.
    fn filtered(&self, values: &[f64], width: usize, height: usize) -> Vec<f64> {
        if !self.zero_padded {
            return self.inside(values, width, height);
        }
        let pad = self.side() / 2;
        let (wide, high) = (width + 2 * pad, height + 2 * pad);
        let mut padded = vec![0.0; wide * high];
        for (row, values) in padded[pad * wide..]
            .chunks_exact_mut(wide)
            .zip(values.chunks_exact(width))
        {
            row[pad..pad + width].copy_from_slice(values);
        }
        self.inside(&padded, wide, high)
    }

    fn inside(&self, values: &[f64], width: usize, height: usize) -> Vec<f64> {
        let out_w = width + 1 - self.side();
        let out_h = height + 1 - self.side();
        let mut rows = vec![0.0; out_w * height];
        for (target, source) in rows.chunks_exact_mut(out_w).zip(values.chunks_exact(width)) {
            for (k, &w) in self.taps.iter().enumerate() {
                for (t, s) in target.iter_mut().zip(&source[k..]) {
                    *t += w * s;
                }
            }
        }
        let mut out = vec![0.0; out_w * out_h];
        for (y, target) in out.chunks_exact_mut(out_w).enumerate() {
            for (k, &w) in self.taps.iter().enumerate() {
                let source = &rows[(y + k) * out_w..(y + k + 1) * out_w];
                for (t, s) in target.iter_mut().zip(source) {
                    *t += w * s;
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::{SsimKind, ssim, ssim_map};
    use crate::image::PlanarImage;
    use crate::image::metric::flat;
    use m4_core::Plane;

    #[test]
    fn ssim_of_flat_images_is_the_luminance_term() {
        let (a, b) = (flat(15, 13, 0.2), flat(15, 13, 0.6));
        let map = ssim_map(SsimKind::GaussianValid, &a, &b, None).unwrap();
        assert_eq!(map.map.size(), (5, 3));
        let want = (2.0 * 0.2 * 0.6 + 1e-4) / (0.2 * 0.2 + 0.6 * 0.6 + 1e-4);
        assert!(
            (map.mean() - want).abs() < 1e-6,
            "{} where {want} was expected",
            map.mean()
        );
        assert!(
            (ssim_map(SsimKind::GaussianValid, &a, &a, None)
                .unwrap()
                .mean()
                - 1.0)
                .abs()
                < 1e-12
        );
    }

    #[test]
    fn bad_input_is_named() {
        let (good, bad, short) = (vec![0.0; 4], vec![0.0, f32::NAN, 0.0, 0.0], vec![0.0; 3]);
        let image =
            |second, third| PlanarImage::from_planes(2, 2, [&good, second, third]).map(drop);
        let map = |a: &PlanarImage, b: &PlanarImage| {
            ssim_map(SsimKind::GaussianValid, a, b, None).map(drop)
        };
        for (result, reason) in [
            (
                map(&flat(16, 16, 0.5), &flat(12, 16, 0.5)),
                "the image is 16x16",
            ),
            (
                map(&flat(10, 20, 0.0), &flat(10, 20, 0.0)),
                "SSIM needs at least 11x11",
            ),
            (image(&bad, &good), "pixel (1, 0) of channel 1 is NaN"),
            (image(&good, &short), "channel 2 has 3"),
        ] {
            let error = result.unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
    }

    #[test]
    fn a_mask_over_everything_changes_nothing_and_an_empty_one_has_no_score() {
        let a: Vec<f32> = (0..400).map(|i| (i * 7 % 23) as f32 / 23.0).collect();
        let b: Vec<f32> = (0..400).map(|i| (i * 5 % 19) as f32 / 19.0).collect();
        let (a, b) = (
            PlanarImage::from_planes(20, 20, [&a, &b, &a]).unwrap(),
            PlanarImage::from_planes(20, 20, [&b, &b, &a]).unwrap(),
        );
        let (all, none) = (Plane::filled(20, 20, 1), Plane::filled(20, 20, 0));
        let kinds = [
            SsimKind::GaussianValid,
            SsimKind::GaussianZeroPadded,
            SsimKind::SkimageUniform,
            SsimKind::DycheckMasked,
        ];
        let mut scores = Vec::new();
        for kind in kinds {
            let score = |mask| ssim(kind, &a, &b, mask).unwrap();
            let whole = score(None).unwrap();
            assert!(
                (score(Some(&all)).unwrap() - whole).abs() < 1e-12 && whole < 0.9,
                "{kind:?}: {whole}"
            );
            assert_eq!(score(Some(&none)), None, "{kind:?}");
            assert!((ssim(kind, &a, &a, None).unwrap().unwrap() - 1.0).abs() < 1e-12);
            scores.push(whole);
        }
        // over all pixels DyCheck's is the plain one; the others are their own
        assert!((scores[0] - scores[3]).abs() < 1e-9);
        scores.truncate(3);
        scores.sort_by(f64::total_cmp);
        assert!(scores.windows(2).all(|w| w[1] - w[0] > 1e-5), "{scores:?}");
    }
}
