//! Shared test code of the networks: tensors against the golden fixtures, and checkpoints with
//! synthetic weights.

use crate::load::{self, Shapes};
use crate::ops::{IMAGENET_MEAN, IMAGENET_STD, planes, tensor};
use burn_core::tensor::{DType, Device, Tensor};
use burn_store::{BurnToPyTorchAdapter, KeyRemapper, ModuleSnapshot};
use m4_core::RgbImage;
use m4_testkit::FormulaWeights;
pub use m4_testkit::{Fixture, assert_close, relative_error};
use tempfile::TempDir;

/// The relative error of a tensor.
#[track_caller]
pub fn assert_near<const D: usize>(got: Tensor<D>, fixture: &Fixture, name: &str, limit: f64) {
    let (want, shape) = fixture.floats(name);
    let dims = got.dims().into_iter().filter(|&n| n != 1);
    let wanted = shape.into_iter().filter(|&n| n != 1);
    assert_eq!(
        dims.collect::<Vec<_>>(),
        wanted.collect::<Vec<_>>(),
        "{name}: shape"
    );
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
    x.reshape([n, c / step, step])
        .narrow(2, 0, 1)
        .squeeze_dim(2)
}

/// Every `step`-th channel of a map `[1, c, h, w]`.
pub fn every_map(x: Tensor<4>, step: usize) -> Tensor<4> {
    let [_, c, h, w] = x.dims();
    x.reshape([c / step, step, h, w])
        .narrow(1, 0, 1)
        .reshape([1, c / step, h, w])
}

/// The lines of `keys` without the blocks of Depth-Anything's backbone from `depth` on.
pub fn of_first_blocks(keys: &str, depth: usize) -> String {
    let block = |line: &str| -> Option<usize> {
        let rest = line.strip_prefix("pretrained.blocks.")?;
        rest.split('.').next()?.parse().ok()
    };
    let lines = keys
        .lines()
        .filter(|line| block(line).is_none_or(|i| i < depth));
    lines.map(|line| format!("{line}\n")).collect()
}

/// `image` as the backbone takes it, `[1, 3, h, w]`.
pub fn normalised(image: &RgbImage, device: &Device) -> Tensor<4> {
    let (w, h) = image.size();
    tensor(
        planes(image, IMAGENET_MEAN, IMAGENET_STD),
        [1, 3, h, w],
        device,
    )
}

/// Fails unless the tensors of `module` are those of `keys` (lines of a name and a shape) after
/// `renames`, without those that are `unneeded`.
#[track_caller]
pub fn assert_same_tensors<M: ModuleSnapshot>(
    module: &M,
    keys: &str,
    renames: &[(&str, &str)],
    unneeded: impl Fn(&str) -> bool,
) {
    let tensors = module.collect(None, Some(Box::new(BurnToPyTorchAdapter)), true);
    let ours: Shapes = tensors
        .iter()
        .map(|t| (t.name.clone(), t.shape.to_vec()))
        .collect();
    let mut theirs = renamed(keys, renames);
    theirs.retain(|name, _| !unneeded(name));
    let missing: Vec<_> = theirs
        .iter()
        .filter(|(name, shape)| ours.get(*name) != Some(shape))
        .collect();
    let surplus: Vec<_> = ours
        .iter()
        .filter(|(name, shape)| theirs.get(*name) != Some(shape))
        .collect();
    assert!(
        missing.is_empty() && surplus.is_empty(),
        "missing {missing:?}, too many {surplus:?}"
    );
}

/// The shapes of `keys` (lines of a name and a shape) by their names after `renames`.
pub fn renamed(keys: &str, renames: &[(&str, &str)]) -> Shapes {
    let patterns = KeyRemapper::from_patterns(renames.to_vec())
        .unwrap()
        .to_regex_pairs();
    let line = |line: &str| {
        let mut words = line.split_whitespace();
        let name = words.next().unwrap().to_owned();
        let name = patterns.iter().fold(name, |name, (from, to)| {
            from.replace_all(&name, to.as_str()).into_owned()
        });
        (name, words.map(|w| w.parse().unwrap()).collect())
    };
    keys.lines().map(line).collect()
}
