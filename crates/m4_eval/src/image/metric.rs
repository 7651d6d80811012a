//! Metrics of images: their names, and PSNR.

use super::{ImageError, PlanarImage, SsimKind, same_size, ssim};
use m4_core::Mask;
use serde::{Deserialize, Serialize};
use std::fmt;

/// A number that two images score. In JSON `{"psnr": "joint"}`, `{"ssim": "skimage_uniform"}`; as text `psnr_joint`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Metric {
    /// Peak signal-to-noise ratio, dB.
    Psnr(PsnrKind),
    /// Structural similarity, 1 at best.
    Ssim(SsimKind),
}

impl Metric {
    /// All variants.
    pub const ALL: [Self; 8] = [
        Self::Psnr(PsnrKind::Joint),
        Self::Psnr(PsnrKind::PerChannel),
        Self::Psnr(PsnrKind::EightBit),
        Self::Ssim(SsimKind::GaussianValid),
        Self::Ssim(SsimKind::GaussianZeroPadded),
        Self::Ssim(SsimKind::SkimageUniform),
        Self::Ssim(SsimKind::SkimageGaussian),
        Self::Ssim(SsimKind::DycheckMasked),
    ];

    /// Scores `image` against `reference`, whole or inside `mask`; `None` if the mask leaves nothing.
    ///
    /// # Errors
    ///
    /// [`ImageError::Size`] if the sizes differ, [`ImageError::TooSmall`] if no window of SSIM fits.
    pub fn score(
        self,
        image: &PlanarImage,
        reference: &PlanarImage,
        mask: Option<&Mask>,
    ) -> Result<Option<f64>, ImageError> {
        match self {
            Self::Psnr(kind) => psnr_db_of(kind, image, reference, mask),
            Self::Ssim(kind) => ssim(kind, image, reference, mask),
        }
    }

    /// Returns the title in a report.
    #[must_use]
    pub fn title(self) -> String {
        match self {
            Self::Psnr(kind) => format!("PSNR {}", kind.title()),
            Self::Ssim(kind) => format!("SSIM {}", kind.title()),
        }
    }
}

/// The name under which a report keeps it.
impl fmt::Display for Metric {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Psnr(PsnrKind::Joint) => "psnr_joint",
            Self::Psnr(PsnrKind::PerChannel) => "psnr_per_channel",
            Self::Psnr(PsnrKind::EightBit) => "psnr_eight_bit",
            Self::Ssim(SsimKind::GaussianValid) => "ssim_gaussian_valid",
            Self::Ssim(SsimKind::GaussianZeroPadded) => "ssim_gaussian_zero_padded",
            Self::Ssim(SsimKind::SkimageUniform) => "ssim_skimage_uniform",
            Self::Ssim(SsimKind::SkimageGaussian) => "ssim_skimage_gaussian",
            Self::Ssim(SsimKind::DycheckMasked) => "ssim_dycheck_masked",
        })
    }
}

/// Score of identical images, dB: the true value is infinite, which no table can average.
pub const MAX_PSNR_DB: f64 = 100.0;

/// Over what the mean squared error is made, and of which numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PsnrKind {
    /// One mean over all pixels and channels: `-10 log10 mean (x - y)^2`. With a mask it is DyCheck's mPSNR (Gao et al., NeurIPS
    /// 2022), with images clamped to 0..1 what most programs call PSNR.
    Joint,
    /// The mean of the PSNR of red, green and blue, as Instant4D and other programs that took it from 3D Gaussian Splatting have
    /// it: a mean of logarithms, never below [`Self::Joint`]. They do not clamp what they rendered: make the images with
    /// [`PlanarImage::from_planes_unclamped`].
    PerChannel,
    /// Of whole numbers from 0 to 255, `20 log10 (255 / sqrt mean)`: `cv2.PSNR` of images in 8 bits (RoDynRF's protocol on NVIDIA
    /// Dynamic). Colours are rounded to the nearest step, halves to the even one as NumPy and OpenCV
    /// do; a program that cuts the fraction off (`astype(uint8)`) scores its own
    /// files a little otherwise.
    EightBit,
}

impl PsnrKind {
    /// Returns the title in a report.
    #[must_use]
    pub fn title(self) -> &'static str {
        match self {
            Self::Joint => "joint over channels",
            Self::PerChannel => "mean over channels of the PSNR of each",
            Self::EightBit => "of colours rounded to 8 bits, joint over channels",
        }
    }
}

/// Peak signal-to-noise ratio in dB, [joint over the channels](PsnrKind::Joint), at most [`MAX_PSNR_DB`]; over the pixels
/// where `mask` is not 0, or all of them. `None` if there is no such pixel.
///
/// # Errors
///
/// [`ImageError::Size`] if the sizes differ.
pub fn psnr_db(image: &PlanarImage, reference: &PlanarImage, mask: Option<&Mask>) -> Result<Option<f64>, ImageError> {
    psnr_db_of(PsnrKind::Joint, image, reference, mask)
}

/// The same of another kind.
///
/// # Errors
///
/// [`ImageError::Size`] if the sizes differ.
pub fn psnr_db_of(
    kind: PsnrKind,
    image: &PlanarImage,
    reference: &PlanarImage,
    mask: Option<&Mask>,
) -> Result<Option<f64>, ImageError> {
    same_size("the image", reference.size(), image.size())?;
    if let Some(mask) = mask {
        same_size("the mask", reference.size(), mask.size())?;
    }
    let squared: fn(f32, f32) -> f64 = match kind {
        PsnrKind::Joint | PsnrKind::PerChannel => |a, b| f64::from(a - b).powi(2),
        PsnrKind::EightBit => |a, b| ((eight_bit(a) - eight_bit(b)) / 255.0).powi(2),
    };
    let inside = |i: usize| mask.is_none_or(|m| m.data()[i] != 0);
    let mut sums = [0.0f64; 3];
    let mut pixels = 0usize;
    for (c, (a, b)) in image.planes().iter().zip(reference.planes()).enumerate() {
        pixels = 0;
        for (i, (&a, &b)) in a.iter().zip(b).enumerate().filter(|&(i, _)| inside(i)) {
            debug_assert!(i < reference.width() * reference.height());
            sums[c] += squared(a, b);
            pixels += 1;
        }
    }
    if pixels == 0 {
        return Ok(None);
    }
    let psnr = |mse: f64| (-10.0 * mse.log10()).min(MAX_PSNR_DB);
    let n = pixels as f64;
    Ok(Some(match kind {
        PsnrKind::PerChannel => sums.map(|sum| psnr(sum / n)).iter().sum::<f64>() / 3.0,
        PsnrKind::Joint | PsnrKind::EightBit => psnr(sums.iter().sum::<f64>() / (3.0 * n)),
    }))
}

fn eight_bit(v: f32) -> f64 {
    f64::from((v.clamp(0.0, 1.0) * 255.0).round_ties_even())
}

#[cfg(test)]
mod tests {
    use super::{MAX_PSNR_DB, Metric, PlanarImage, PsnrKind, psnr_db, psnr_db_of};
    use crate::image::planar::flat;
    use crate::image::{ImageError, ssim_map};
    use m4_core::Plane;
    use std::collections::BTreeSet;

    #[test]
    fn names_are_their_own_and_those_of_json() {
        let names: BTreeSet<String> = Metric::ALL.iter().map(Metric::to_string).collect();
        let titles: BTreeSet<String> = Metric::ALL.iter().map(|m| m.title()).collect();
        assert_eq!((names.len(), titles.len()), (8, 8));
        for metric in Metric::ALL {
            let json = serde_json::to_string(&metric).unwrap();
            assert_eq!(serde_json::from_str::<Metric>(&json).unwrap(), metric);
            let plain = json.replace(['{', '}', '"'], "").replace(':', "_");
            assert_eq!(plain, metric.to_string());
        }
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
        let a = PlanarImage::from_planes(2, 2, [&third, &over, &zero]).unwrap();
        let b = PlanarImage::from_planes(2, 2, [&zero, &one, &zero]).unwrap();
        let got = psnr_db(&a, &b, None).unwrap().unwrap();
        assert!((got + 10.0 * 0.03f64.log10()).abs() < 1e-5, "{got}");
    }

    #[test]
    fn a_mask_selects_pixels() {
        let reference = flat(20, 20, 0.5);
        let plane: Vec<f32> = (0..400).map(|i| if i % 20 < 10 { 0.6 } else { 0.5 }).collect();
        let image = PlanarImage::from_planes(20, 20, [&plane, &plane, &plane]).unwrap();
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
    fn kinds_differ_where_channels_do_and_where_nothing_is_clamped() {
        let (zero, tenth, over) = (vec![0.0; 4], vec![0.1; 4], vec![1.01; 4]);
        let a = PlanarImage::from_planes_unclamped(2, 2, [&tenth, &over, &tenth]).unwrap();
        let b = PlanarImage::from_planes(2, 2, [&zero, &over, &zero]).unwrap();
        let db = |kind| psnr_db_of(kind, &a, &b, None).unwrap().unwrap();
        // squared errors 0.01, 0.0001 and 0.01
        assert!((db(PsnrKind::Joint) + 10.0 * (0.0201f64 / 3.0).log10()).abs() < 1e-4);
        assert!((db(PsnrKind::PerChannel) - 80.0 / 3.0).abs() < 1e-4, "{}", db(PsnrKind::PerChannel));
        // 25.5 is 26 of 255, 1.01 is white
        let want = -10.0 * (2.0 * (26.0f64 / 255.0).powi(2) / 3.0).log10();
        assert!((db(PsnrKind::EightBit) - want).abs() < 1e-9);
        let name = serde_json::to_string(&PsnrKind::EightBit).unwrap();
        assert_eq!(name, "\"eight_bit\"");
    }

    #[test]
    fn other_sizes_are_refused() {
        let (a, b) = (flat(16, 16, 0.5), flat(12, 16, 0.5));
        assert!(matches!(psnr_db(&a, &b, None), Err(ImageError::Size { .. })));
        let mask = Plane::filled(3, 3, 255);
        assert!(matches!(psnr_db(&a, &a, Some(&mask)), Err(ImageError::Size { .. })));
    }
}
