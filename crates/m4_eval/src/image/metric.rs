//! The pixels that metrics read; the names of the metrics, and PSNR.

use super::{SsimKind, ssim};
use m4_core::{Mask, Plane, RgbImage};
use serde::{Deserialize, Serialize};
use std::fmt;

/// A number that two images score. In JSON `{"psnr": "joint"}`, `{"ssim": "skimage_uniform"}`; as
/// text `psnr_joint`.
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
    pub const ALL: [Self; 7] = [
        Self::Psnr(PsnrKind::Joint),
        Self::Psnr(PsnrKind::PerChannel),
        Self::Psnr(PsnrKind::EightBit),
        Self::Ssim(SsimKind::GaussianValid),
        Self::Ssim(SsimKind::GaussianZeroPadded),
        Self::Ssim(SsimKind::SkimageUniform),
        Self::Ssim(SsimKind::DycheckMasked),
    ];

    /// Scores `image` against `reference`, whole or inside `mask`; `None` if the mask leaves
    /// nothing.
    ///
    /// # Errors
    ///
    /// [`ImageError`] if the sizes differ or no window of SSIM fits.
    pub fn score(
        self,
        image: &PlanarImage,
        reference: &PlanarImage,
        mask: Option<&Mask>,
    ) -> Result<Option<f64>, ImageError> {
        match self {
            Self::Psnr(kind) => psnr_db(kind, image, reference, mask),
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
    /// One mean over all pixels and channels: `-10 log10 mean (x - y)^2`. With a mask it is
    /// DyCheck's mPSNR (Gao et al., NeurIPS 2022), with images clamped to 0..1 what most programs
    /// call PSNR.
    Joint,
    /// The mean of the PSNR of red, green and blue, as Instant4D and other programs that took it
    /// from 3D Gaussian Splatting have it: a mean of logarithms, never below [`Self::Joint`]. They
    /// do not clamp what they rendered: make the images with
    /// [`PlanarImage::from_planes_unclamped`].
    PerChannel,
    /// Of whole numbers from 0 to 255, `20 log10 (255 / sqrt mean)`: `cv2.PSNR` of images in 8 bits
    /// (RoDynRF's protocol on NVIDIA Dynamic). Colours are rounded to the nearest step, halves to
    /// the even one as NumPy and OpenCV do; a program that cuts the fraction off (`astype(uint8)`)
    /// scores its own files a little otherwise.
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

/// Peak signal-to-noise ratio in dB, at most [`MAX_PSNR_DB`]; over the pixels where `mask` is not
/// 0, or all of them. `None` if there is no such pixel.
///
/// # Errors
///
/// [`ImageError`] if the sizes differ.
pub fn psnr_db(
    kind: PsnrKind,
    image: &PlanarImage,
    reference: &PlanarImage,
    mask: Option<&Mask>,
) -> Result<Option<f64>, ImageError> {
    check_sizes(image, reference, mask)?;
    let squared: fn(f32, f32) -> f64 = match kind {
        PsnrKind::Joint | PsnrKind::PerChannel => |a, b| f64::from(a - b).powi(2),
        PsnrKind::EightBit => |a, b| ((eight_bit(a) - eight_bit(b)) / 255.0).powi(2),
    };
    let inside = |i: usize| mask.is_none_or(|m| m.data()[i] != 0);
    let mut sums = [0.0f64; 3];
    let mut pixels = 0usize;
    for (c, (a, b)) in image.planes().iter().zip(reference.planes()).enumerate() {
        pixels = 0;
        for (_, (&a, &b)) in a.iter().zip(b).enumerate().filter(|&(i, _)| inside(i)) {
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

/// Why two images could not be compared: other sizes, too few pixels, or values that are no
/// numbers; the text says which.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct ImageError(pub(super) String);

pub(super) fn same_size(
    what: &'static str,
    expected: (usize, usize),
    actual: (usize, usize),
) -> Result<(), ImageError> {
    if expected == actual {
        return Ok(());
    }
    Err(ImageError(format!(
        "{what} is {}x{} but the reference is {}x{}; render or resize to the size of the reference first",
        actual.0, actual.1, expected.0, expected.1
    )))
}

/// That an image and its mask, if there is one, are as large as the reference.
pub(super) fn check_sizes(
    image: &PlanarImage,
    reference: &PlanarImage,
    mask: Option<&Mask>,
) -> Result<(), ImageError> {
    same_size("the image", reference.size(), image.size())?;
    mask.map_or(Ok(()), |mask| {
        same_size("the mask", reference.size(), mask.size())
    })
}

/// A colour image in three planes, `[height][width]` each, sRGB values in `[0, 1]`, or beyond where
/// a protocol does not clamp.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanarImage {
    width: usize,
    height: usize,
    planes: [Vec<f32>; 3],
}

impl PlanarImage {
    /// Takes planar colours, `[3][height][width]`, and clamps them to `[0, 1]`.
    ///
    /// # Errors
    ///
    /// [`ImageError`] if a plane does not hold `width * height` values, or a value is NaN or
    /// infinite.
    pub fn from_planes(
        width: usize,
        height: usize,
        planes: [&[f32]; 3],
    ) -> Result<Self, ImageError> {
        let mut image = Self::from_planes_unclamped(width, height, planes)?;
        for value in image.planes.iter_mut().flatten() {
            *value = value.clamp(0.0, 1.0);
        }
        Ok(image)
    }

    /// The same without clamping, for protocols that score unclamped renders.
    ///
    /// # Errors
    ///
    /// As [`Self::from_planes`].
    pub fn from_planes_unclamped(
        width: usize,
        height: usize,
        planes: [&[f32]; 3],
    ) -> Result<Self, ImageError> {
        for (channel, plane) in planes.iter().enumerate() {
            let (expected, count) = (width * height, plane.len());
            if count != expected {
                return Err(ImageError(format!(
                    "an image of {width}x{height} needs planes of {expected} values; channel {channel} has {count}"
                )));
            }
            if let Some(i) = plane.iter().position(|v| !v.is_finite()) {
                return Err(ImageError(format!(
                    "pixel ({}, {}) of channel {channel} is {}; only finite colours can be scored",
                    i % width,
                    i / width,
                    plane[i]
                )));
            }
        }
        let planes = planes.map(<[f32]>::to_vec);
        Ok(Self {
            width,
            height,
            planes,
        })
    }

    /// `(width, height)`.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// The three colour planes, `[height][width]` each, in `[0, 1]` unless made without clamping.
    #[must_use]
    pub fn planes(&self) -> &[Vec<f32>; 3] {
        &self.planes
    }
}

impl From<&RgbImage> for PlanarImage {
    fn from(image: &RgbImage) -> Self {
        let plane = |c: usize| {
            image
                .data()
                .iter()
                .map(|rgb| f32::from(rgb[c]) / 255.0)
                .collect()
        };
        Self {
            width: image.width(),
            height: image.height(),
            planes: [plane(0), plane(1), plane(2)],
        }
    }
}

/// An image of one value, for tests.
#[cfg(test)]
pub(super) fn flat(width: usize, height: usize, value: f32) -> PlanarImage {
    let plane = vec![value; width * height];
    PlanarImage::from_planes(width, height, [&plane, &plane, &plane]).unwrap()
}

/// The mask grown by `radius_px` in every direction (a square of side `2 radius + 1`).
#[must_use]
pub fn dilated(mask: &Mask, radius_px: usize) -> Mask {
    let (width, height) = mask.size();
    let grown = m4_core::dilated(mask.data(), width, height, radius_px);
    Plane::from_fn(width, height, |x, y| grown[y * width + x])
}

#[cfg(test)]
mod tests {
    use super::{MAX_PSNR_DB, Metric, PlanarImage, PsnrKind, dilated, flat, psnr_db};
    use crate::image::{SsimKind, ssim_map};
    use m4_core::Plane;
    use std::collections::BTreeSet;

    #[test]
    fn names_are_their_own_and_those_of_json() {
        let names: BTreeSet<String> = Metric::ALL.iter().map(Metric::to_string).collect();
        let titles: BTreeSet<String> = Metric::ALL.iter().map(|m| m.title()).collect();
        assert_eq!((names.len(), titles.len()), (7, 7));
        for metric in Metric::ALL {
            let json = serde_json::to_string(&metric).unwrap();
            assert_eq!(serde_json::from_str::<Metric>(&json).unwrap(), metric);
            let plain = json.replace(['{', '}', '"'], "").replace(':', "_");
            assert_eq!(plain, metric.to_string());
        }
    }

    #[test]
    fn a_mask_selects_pixels() {
        let reference = flat(20, 20, 0.5);
        let plane: Vec<f32> = (0..400)
            .map(|i| if i % 20 < 10 { 0.6 } else { 0.5 })
            .collect();
        let image = PlanarImage::from_planes(20, 20, [&plane, &plane, &plane]).unwrap();
        let left = Plane::from_fn(20, 20, |x, _| if x < 10 { 255 } else { 0 });
        let right = left.map(|&m| 255 - m);
        let db = |mask| psnr_db(PsnrKind::Joint, &image, &reference, Some(mask)).unwrap();
        assert!((db(&left).unwrap() - 20.0).abs() < 1e-5);
        assert_eq!(db(&right), Some(MAX_PSNR_DB));
        assert_eq!(db(&Plane::filled(20, 20, 0)), None);
        let map = ssim_map(SsimKind::GaussianValid, &image, &reference, None).unwrap();
        // Windows that reach at most to column 15 + 5 from the step see only equal pixels.
        let far = Plane::from_fn(20, 20, |x, _| if x >= 15 { 255 } else { 0 });
        assert!(map.mean_inside(&far).is_none());
        let inner = Plane::from_fn(20, 20, |x, _| if x == 10 { 255 } else { 0 });
        let (inside, all) = (map.mean_inside(&inner).unwrap(), map.mean());
        assert!(inside < all && all < 1.0, "{inside} {all}");
    }

    #[test]
    fn equal_images_score_the_most_and_other_sizes_are_refused() {
        let (a, b) = (flat(16, 16, 0.5), flat(12, 16, 0.5));
        assert_eq!(
            psnr_db(PsnrKind::Joint, &a, &a, None).unwrap(),
            Some(MAX_PSNR_DB)
        );
        assert!(
            psnr_db(PsnrKind::Joint, &a, &b, None)
                .unwrap_err()
                .to_string()
                .starts_with("the image is 16x16")
        );
        let error = psnr_db(PsnrKind::Joint, &a, &a, Some(&Plane::filled(3, 3, 255))).unwrap_err();
        assert!(error.to_string().starts_with("the mask is 3x3"), "{error}");
    }

    #[test]
    fn dilation_grows_a_square() {
        let dot = Plane::from_fn(9, 9, |x, y| if (x, y) == (4, 1) { 255 } else { 0 });
        let grown = dilated(&dot, 2);
        let count = grown.data().iter().filter(|&&m| m == 255).count();
        assert_eq!(count, 5 * 4);
        assert_eq!(dilated(&dot, 0), dot);
    }
}
