//! Shared test code of the networks: the golden fixtures, and checkpoints with synthetic weights.

use crate::load::{self, Shapes};
use crate::ops::{IMAGENET_MEAN, IMAGENET_STD, planes, tensor};
use burn_core::tensor::{DType, Device, Tensor};
use burn_store::{BurnToPyTorchAdapter, KeyRemapper, ModuleSnapshot};
use m4_core::RgbImage;
use m4_testkit::FormulaWeights;
use safetensors::{Dtype, SafeTensors};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// A file of the folder of fixtures.
pub struct Fixture(Vec<u8>);

impl Fixture {
    pub fn open(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures");
        Self(fs::read(folder.join(name)).unwrap())
    }

    /// Bytes, type and shape of a tensor.
    fn tensor(&self, name: &str) -> (Vec<u8>, Dtype, Vec<usize>) {
        let tensors = SafeTensors::deserialize(&self.0).unwrap();
        let tensor = tensors.tensor(name).unwrap();
        (tensor.data().to_vec(), tensor.dtype(), tensor.shape().to_vec())
    }

    /// The words of a tensor, which are of type `dtype`.
    fn words<const N: usize>(&self, name: &str, dtype: Dtype) -> (Vec<[u8; N]>, Vec<usize>) {
        let (bytes, found, shape) = self.tensor(name);
        assert_eq!(found, dtype, "{name}");
        (bytes.as_chunks::<N>().0.to_vec(), shape)
    }

    /// A tensor of 32-bit numbers, and its shape.
    pub fn floats(&self, name: &str) -> (Vec<f32>, Vec<usize>) {
        let (words, shape) = self.words(name, Dtype::F32);
        (words.into_iter().map(f32::from_le_bytes).collect(), shape)
    }

    /// A tensor of 64-bit numbers.
    pub fn doubles(&self, name: &str) -> Vec<f64> {
        self.words(name, Dtype::F64).0.into_iter().map(f64::from_le_bytes).collect()
    }

    /// A tensor of 64-bit integers.
    pub fn indices(&self, name: &str) -> Vec<usize> {
        self.words(name, Dtype::I64).0.into_iter().map(|word| i64::from_le_bytes(word) as usize).collect()
    }

    /// A tensor of 32-bit integers.
    pub fn whole(&self, name: &str) -> Vec<i32> {
        self.words(name, Dtype::I32).0.into_iter().map(i32::from_le_bytes).collect()
    }

    /// A tensor of 16-bit integers.
    pub fn shorts(&self, name: &str) -> Vec<i16> {
        self.words(name, Dtype::I16).0.into_iter().map(i16::from_le_bytes).collect()
    }

    /// A tensor of bytes.
    pub fn bytes(&self, name: &str) -> Vec<u8> {
        self.words::<1>(name, Dtype::U8).0.into_flattened()
    }

    /// An image of `[3, h, w]` bytes.
    pub fn image(&self, name: &str) -> RgbImage {
        let (_, _, shape) = self.tensor(name);
        let [3, h, w] = shape[..] else {
            panic!("{name} is not an image");
        };
        let bytes = self.bytes(name);
        RgbImage::from_fn(w, h, |x, y| [0, 1, 2].map(|c| bytes[(c * h + y) * w + x]))
    }
}

/// `max |a - b| / max |b|`; there have to be as many numbers, not all of them zero, and none that is not finite.
pub fn relative_error(got: &[f32], want: &[f32]) -> f64 {
    assert_eq!(got.len(), want.len(), "numbers");
    let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
    assert!(got.iter().chain(want).all(|x| x.is_finite()), "a number that is not finite");
    let scale = largest(&mut want.iter().map(|&x| f64::from(x).abs()));
    assert!(scale > 0.0, "nothing but zeros is wanted");
    largest(&mut got.iter().zip(want).map(|(&a, &b)| (f64::from(a) - f64::from(b)).abs())) / scale
}

/// Fails unless the [relative error](relative_error) is below `limit`.
#[track_caller]
pub fn assert_close(what: &str, got: &[f32], want: &[f32], limit: f64) {
    let error = relative_error(got, want);
    println!("{what}: {error:.1e}");
    assert!(error < limit, "{what}: relative error {error:e}, limit {limit:e}");
}

/// The relative error of a tensor.
#[track_caller]
pub fn assert_near<const D: usize>(got: Tensor<D>, fixture: &Fixture, name: &str, limit: f64) {
    let (want, shape) = fixture.floats(name);
    let dims = got.dims().into_iter().filter(|&n| n != 1);
    let wanted = shape.into_iter().filter(|&n| n != 1);
    assert_eq!(dims.collect::<Vec<_>>(), wanted.collect::<Vec<_>>(), "{name}: shape");
    let got: Vec<f32> = got.cast(DType::F32).try_into_vec_as().unwrap();
    assert_close(name, &got, &want, limit);
}

/// Fills `module` with `weights`.
pub fn fill_by_formula<M: ModuleSnapshot>(
    module: &mut M,
    weights: &FormulaWeights,
    renames: &[(&str, &str)],
    unneeded: impl Fn(&str) -> bool,
) {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("weights.safetensors");
    weights.write(&path);
    load::fill(module, "a network of a test", &path, renames, unneeded).unwrap();
}

/// Every `step`-th channel, the last axis.
pub fn every(x: Tensor<2>, step: usize) -> Tensor<2> {
    let [n, c] = x.dims();
    x.reshape([n, c / step, step]).narrow(2, 0, 1).squeeze_dim(2)
}

/// Every `step`-th channel of a map `[1, c, h, w]`.
pub fn every_map(x: Tensor<4>, step: usize) -> Tensor<4> {
    let [_, c, h, w] = x.dims();
    x.reshape([c / step, step, h, w]).narrow(1, 0, 1).reshape([1, c / step, h, w])
}

/// The lines of `keys` without the blocks of Depth-Anything's backbone from `depth` on.
pub fn of_first_blocks(keys: &str, depth: usize) -> String {
    let block = |line: &str| -> Option<usize> {
        let rest = line.strip_prefix("pretrained.blocks.")?;
        rest.split('.').next()?.parse().ok()
    };
    let kept = keys.lines().filter(|line| block(line).is_none_or(|i| i < depth));
    kept.map(|line| format!("{line}\n")).collect()
}

/// `image` as the backbone takes it, `[1, 3, h, w]`.
pub fn normalised(image: &RgbImage, device: &Device) -> Tensor<4> {
    let (w, h) = image.size();
    tensor(planes(image, IMAGENET_MEAN, IMAGENET_STD), [1, 3, h, w], device)
}

/// Fails unless the tensors of `module` are those of `keys` (lines of a name and a shape) after `renames`, without those that are
/// `unneeded`.
#[track_caller]
pub fn assert_same_tensors<M: ModuleSnapshot>(
    module: &M,
    keys: &str,
    renames: &[(&str, &str)],
    unneeded: impl Fn(&str) -> bool,
) {
    let tensors = module.collect(None, Some(Box::new(BurnToPyTorchAdapter)), true);
    let ours: Shapes = tensors.iter().map(|t| (t.name.clone(), t.shape.to_vec())).collect();
    let mut theirs = renamed(keys, renames);
    theirs.retain(|name, _| !unneeded(name));
    let missing: Vec<_> = theirs.iter().filter(|(name, shape)| ours.get(*name) != Some(shape)).collect();
    let surplus: Vec<_> = ours.iter().filter(|(name, shape)| theirs.get(*name) != Some(shape)).collect();
    assert!(missing.is_empty() && surplus.is_empty(), "missing {missing:?}, too many {surplus:?}");
}

/// The shapes of `keys` (lines of a name and a shape) by their names after `renames`.
pub fn renamed(keys: &str, renames: &[(&str, &str)]) -> Shapes {
    let patterns = KeyRemapper::from_patterns(renames.to_vec()).unwrap().to_regex_pairs();
    let line = |line: &str| {
        let mut words = line.split_whitespace();
        let name = words.next().unwrap().to_owned();
        let name = patterns.iter().fold(name, |name, (from, to)| from.replace_all(&name, to.as_str()).into_owned());
        (name, words.map(|w| w.parse().unwrap()).collect())
    };
    keys.lines().map(line).collect()
}
