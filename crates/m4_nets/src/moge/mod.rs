//! MoGe-2: depth in metres, field of view and mask of one image.
//!
//! - Papers: Wang et al., "MoGe: Unlocking Accurate Monocular Geometry Estimation for Open-Domain
//!   Images with Optimal Training Supervision", CVPR 2025; "MoGe-2: Accurate Monocular Geometry
//!   with Metric Scale and Sharp Details", 2025.
//! - Upstream: microsoft/MoGe, MIT (its copy of DINOv2 Apache-2.0), weights too.
//!
//! ```text
//! image --antialiased bilinear--> 14 x 14 patches --DINOv2, four blocks summed--> map, class token
//! map --neck: 5 levels of doubling size, each told where its pixels are--> 5 maps --heads--> points and mask at 16 x the patches
//! class token --three layers--> metric scale;  points + mask --one unknown--> focal length, depth offset --> depth in metres
//! ```
//!
//! The number of patches is free. Widths, levels and heads are read off the checkpoint's tensors;
//! what they cannot tell (which blocks are tapped, how many patches it was trained with) is read
//! from the `model_config` of the official files, and is that of the public training configuration
//! where a file has none: the last block of each quarter, 1200 to 3600. The three numbers `a, b, c`
//! of a point are `z = exp c` and `(x, y) = (a, b) z`.

mod focal;
mod image;
mod layout;
mod stack;
#[cfg(test)]
mod tests;

pub use image::{MoGeMap, MoGeOptions};

use crate::dinov2::{self, BackboneSize};
use crate::error::numbers;
use crate::ops::linear;
use crate::{Compute, LoadError, NetError, load};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::{Device, Tensor};
use burn_nn::Linear;
use image::{Grid, RawOutput};
use layout::{Config, Layout};
use m4_core::RgbImage;
use stack::{Encoder, Stack};
use std::path::Path;

const NAME: &str = "MoGe-2";

/// The network with its weights.
#[derive(Debug)]
pub struct MoGe {
    net: Net,
    config: Config,
    device: Device,
}

#[derive(Module, Debug)]
struct Net {
    encoder: Encoder,
    neck: Stack,
    points_head: Stack,
    mask_head: Stack,
    scale_head: Scale,
}

/// The head for scale. Its layers are named `0`, `2`, `4` in the checkpoint.
#[derive(Module, Debug)]
struct Scale {
    layers: Vec<Linear>,
}

/// Names of the checkpoint that are not those of fields.
const RENAMES: [(&str, &str); 9] = [
    (r"^model\.", ""),
    (r"\.resamplers\.(\d+)\.0\.", ".resamplers.$1.transposed."),
    (r"\.resamplers\.(\d+)\.1\.", ".resamplers.$1.conv."),
    (r"\.layers\.2\.", ".conv1."),
    (r"\.layers\.5\.", ".conv2."),
    (r"^scale_head\.0\.", "scale_head.layers.0."),
    (r"^scale_head\.2\.", "scale_head.layers.1."),
    (r"^scale_head\.4\.", "scale_head.layers.2."),
    (r"^scale_head\.6\.", "scale_head.layers.3."),
];

/// Tensors that depth does not need: the head for normals, and what only training used.
fn unneeded(name: &str) -> bool {
    name.starts_with("normal_head.") || dinov2::unneeded(name)
}

impl Scale {
    /// Of the class token `[b, c]`: the logarithm of metres in a unit, `[b, 1]`.
    fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        let mut layers = self.layers.iter();
        let first = layers.next().map(|layer| layer.forward(x.clone()));
        layers.fold(first.unwrap_or(x), |x, layer| layer.forward(relu(x)))
    }
}

/// What the network gives away, on the device.
struct Outputs {
    points: Tensor<4>,
    mask: Tensor<4>,
    log_scale: Tensor<2>,
}

impl Net {
    fn new(size: BackboneSize, layout: &Layout, device: &Device) -> Self {
        let scale = layout.scale.iter().zip(layout.scale.iter().skip(1));
        Self {
            encoder: Encoder::new(size, layout.taps, layout.encoder, device),
            neck: Stack::new(&layout.neck, device),
            points_head: Stack::new(&layout.points, device),
            mask_head: Stack::new(&layout.mask, device),
            scale_head: Scale {
                layers: scale
                    .map(|(&from, &to)| linear(from, to, true, device))
                    .collect(),
            },
        }
    }

    /// What the neck makes of an image `[1, 3, 14 h, 14 w]`, from small to large, and the class
    /// token.
    fn features(
        &self,
        image: Tensor<4>,
        taps: &[usize],
        grid: Grid,
    ) -> (Vec<Tensor<4>>, Tensor<2>) {
        let (map, class) = self.encoder.forward(image, taps, [grid.down, grid.across]);
        let (device, dtype) = (map.device(), map.dtype());
        let places = (0..self.neck.levels()).map(|level| grid.places(level, &device, dtype));
        let mut inputs: Vec<Tensor<4>> = places.collect();
        if let Some(first) = inputs.first_mut() {
            *first = Tensor::cat(vec![map, first.clone()], 1);
        }
        (self.neck.forward(&inputs), class)
    }

    fn forward(&self, image: Tensor<4>, taps: &[usize], grid: Grid) -> Outputs {
        let (features, class) = self.features(image, taps, grid);
        Outputs {
            points: self.points_head.last(&features),
            mask: self.mask_head.last(&features),
            log_scale: self.scale_head.forward(class),
        }
    }
}

impl MoGe {
    /// The network with the weights of the checkpoint at `path`, on `device`: an official
    /// `model.pt`, or its tensors as safetensors.
    ///
    /// # Errors
    ///
    /// [`LoadError`] if the file cannot be read or holds another network.
    pub fn load(path: &Path, on: impl Into<Compute>) -> Result<Self, LoadError> {
        let on: Compute = on.into();
        let shapes = load::shapes(NAME, path, &RENAMES)?;
        let size = BackboneSize::in_checkpoint(&shapes, "encoder.backbone.", NAME, path)?;
        let other = |wrong: String| LoadError::misfit(NAME, path, &[], &[wrong]);
        let taps = Layout::taps_of(&shapes);
        let config = Config::of_checkpoint(path, size).map_err(other)?;
        let layout = Layout::in_checkpoint(&shapes).map_err(other)?;
        let rising = config.taps.windows(2).all(|pair| pair[0] < pair[1]);
        if config.taps.len() != taps
            || !rising
            || config.taps.iter().any(|&tap| tap >= size.depth())
        {
            let wrong = format!(
                "blocks {:?} are to be tapped by {taps} projections",
                config.taps
            );
            return Err(other(wrong));
        }
        let mut net = Net::new(size, &layout, &on.device);
        load::fill(&mut net, NAME, path, &RENAMES, unneeded)?;
        Ok(Self {
            net: on.fit(net),
            config,
            device: on.device,
        })
    }

    /// The geometry of `image`.
    ///
    /// # Errors
    ///
    /// [`NetError`] if the image has no pixels, an option is out of range, the network finds no
    /// depth, or the device fails.
    pub fn infer(&self, image: &RgbImage, options: &MoGeOptions) -> Result<MoGeMap, NetError> {
        self.raw_output(image, options)?
            .geometry(options.known_focal_px)
    }

    /// What the network says of `image`.
    fn raw_output(&self, image: &RgbImage, options: &MoGeOptions) -> Result<RawOutput, NetError> {
        let tokens = options.tokens.unwrap_or(self.config.tokens.1);
        let grid = Grid::of(image.size(), tokens)?;
        let out = self
            .net
            .forward(grid.tensor(image, &self.device), &self.config.taps, grid);
        let planes = |x: Tensor<4>| {
            let [_, _, h, w] = x.dims();
            numbers(x).map(|values| grid.to_image(&values, w, h))
        };
        let points = planes(out.points)?;
        let mask = planes(out.mask)?;
        let log_scale = numbers(out.log_scale)?.first().copied().unwrap_or(f32::NAN);
        Ok(RawOutput::of_planes(
            image.size(),
            &points,
            &mask,
            log_scale.exp(),
        ))
    }
}
