//! What the tensors of a checkpoint cannot tell: its `model_config`, and what was published where a file has none.

use super::layout::Norm;
use crate::dinov2::BackboneSize;
use burn_store::pytorch_reader::{PickleValue, PytorchReader};
use std::path::Path;

/// What becomes of the three numbers of a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Remap {
    Linear,
    Sinh,
    /// `z = exp c`, and `(x, y) = (a, b) z`.
    Exp,
    SinhExp,
}

impl Remap {
    fn named(name: &str) -> Option<Self> {
        match name {
            "linear" => Some(Self::Linear),
            "sinh" => Some(Self::Sinh),
            "exp" => Some(Self::Exp),
            "sinh_exp" => Some(Self::SinhExp),
            _ => None,
        }
    }

    /// The point of three numbers.
    pub fn point(self, [a, b, c]: [f32; 3]) -> [f32; 3] {
        match self {
            Self::Linear => [a, b, c],
            Self::Sinh => [a.sinh(), b.sinh(), c.sinh()],
            Self::Exp => {
                let z = c.exp();
                [a * z, b * z, z]
            }
            Self::SinhExp => [a.sinh(), b.sinh(), c.exp()],
        }
    }
}

/// What a checkpoint says of itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// Blocks of the backbone that are tapped, counted from 0.
    pub taps: Vec<usize>,
    /// Least and most patches that it was trained with.
    pub tokens: (usize, usize),
    pub remap: Remap,
    /// Normalisations of the stacks, by their names.
    norms: Vec<(String, [Norm; 2])>,
}

/// Default normalisations.
const NORMS: [Norm; 2] = [Norm::Layer, Norm::Group];

impl Config {
    /// Of a backbone of `size`: four blocks at equal distances, the last among them, 1200 to 3600 patches, exponential depth. The published
    /// training configuration is that of the large one, whose blocks are 5, 11, 17 and 23.
    pub fn published(size: BackboneSize) -> Self {
        Self {
            taps: (1..=4).map(|i| i * size.depth() / 4 - 1).collect(),
            tokens: (1200, 3600),
            remap: Remap::Exp,
            norms: Vec::new(),
        }
    }

    /// That of the checkpoint at `path`, where it has one: the official ones are a dictionary of `model_config` and `model`.
    ///
    /// # Errors
    ///
    /// What it says that is not known here.
    pub fn of_checkpoint(path: &Path, size: BackboneSize) -> Result<Self, String> {
        let mut config = Self::published(size);
        if path.extension().is_some_and(|end| end == "safetensors") {
            return Ok(config);
        }
        // a file without that key is a plain list of tensors; one that cannot be read fails when its tensors are
        if let Ok(stored) = PytorchReader::read_pickle_data(path, Some("model_config")) {
            config.read(&stored).map_err(|reason| format!("of its model_config, {reason}"))?;
        }
        Ok(config)
    }

    /// Takes over what `stored` has.
    pub(super) fn read(&mut self, stored: &PickleValue) -> Result<(), String> {
        if let Some(layers) = entry(stored, "encoder").and_then(|encoder| entry(encoder, "intermediate_layers")) {
            self.taps = match layers {
                PickleValue::List(_) => numbers(layers).ok_or("intermediate_layers are not block numbers")?,
                _ => return Err("intermediate_layers are no list of blocks".into()),
            };
        }
        if let Some(range) = entry(stored, "num_tokens_range") {
            let range = numbers(range).filter(|r| r.len() == 2 && 0 < r[0] && r[0] <= r[1]);
            let range = range.ok_or("num_tokens_range is not two rising numbers")?;
            self.tokens = (range[0], range[1]);
        }
        if let Some(remap) = entry(stored, "remap_output") {
            let name = text(remap).unwrap_or_default();
            self.remap = Remap::named(name).ok_or_else(|| format!("remap_output = {remap:?} is not known"))?;
        }
        for stack in ["neck", "points_head", "mask_head", "normal_head"] {
            if let Some(stored) = entry(stored, stack) {
                let norms = stack_norms(stored).map_err(|reason| format!("{stack}: {reason}"))?;
                self.norms.push((stack.to_owned(), norms));
            }
        }
        Ok(())
    }

    /// The normalisations of the stack `name`, where it has any.
    pub fn norms(&self, name: &str) -> [Norm; 2] {
        let found = self.norms.iter().find(|(stack, _)| stack == name);
        found.map_or(NORMS, |(_, norms)| *norms)
    }
}

fn stack_norms(stored: &PickleValue) -> Result<[Norm; 2], String> {
    if let Some(activation) = entry(stored, "activation").filter(|&name| text(name) != Some("relu")) {
        return Err(format!("activation = {activation:?} is not known"));
    }
    let ups = match entry(stored, "resamplers") {
        Some(PickleValue::List(ups)) => ups.as_slice(),
        Some(one) => std::slice::from_ref(one),
        None => &[],
    };
    let known = |up: &&PickleValue| matches!(text(up), Some("conv_transpose" | "bilinear"));
    if let Some(up) = ups.iter().find(|up| !known(up)) {
        return Err(format!("resamplers of {up:?} are not known"));
    }
    let mut norms = NORMS;
    for (norm, key) in norms.iter_mut().zip(["res_block_in_norm", "res_block_hidden_norm"]) {
        *norm = match entry(stored, key).map(|name| (name, text(name))) {
            // without one there is no tensor of it, and its kind is never asked for
            None | Some((_, Some("none"))) => *norm,
            Some((_, Some("layer_norm"))) => Norm::Layer,
            Some((_, Some("group_norm"))) => Norm::Group,
            Some((other, _)) => return Err(format!("{key} = {other:?} is not known")),
        };
    }
    Ok(norms)
}

fn entry<'a>(value: &'a PickleValue, key: &str) -> Option<&'a PickleValue> {
    match value {
        PickleValue::Dict(entries) => entries.get(key).filter(|value| **value != PickleValue::None),
        _ => None,
    }
}

fn text(value: &PickleValue) -> Option<&str> {
    match value {
        PickleValue::String(text) => Some(text),
        _ => None,
    }
}

fn numbers(value: &PickleValue) -> Option<Vec<usize>> {
    let PickleValue::List(values) = value else { return None };
    let number = |value: &PickleValue| match value {
        PickleValue::Int(n) => usize::try_from(*n).ok(),
        _ => None,
    };
    values.iter().map(number).collect()
}
