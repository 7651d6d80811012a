//! Metrics by name.

use super::{ImageError, PlanarImage, PsnrKind, SsimKind, psnr_db_of, ssim};
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

#[cfg(test)]
mod tests {
    use super::Metric;
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
}
