//! The widths and depths of a checkpoint, derived from the shapes of its tensors.

use crate::dinov2::BackboneSize;
use crate::load::Shapes;
use burn_store::pytorch_reader::{PickleValue, PytorchReader};
use std::path::Path;

/// How a level becomes the next, of twice its size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Up {
    /// A transposed convolution, then one of 3 x 3.
    Transposed,
    /// Bilinear, then a convolution of 3 x 3.
    Bilinear,
}

/// A level of a stack.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Level {
    /// Channels of what comes in, where a convolution takes it.
    pub input: Option<usize>,
    /// Channels.
    pub width: usize,
    /// Channels in the middle of each residual block.
    pub blocks: Vec<usize>,
    /// How it becomes the next level; of no meaning in the last.
    pub up: Up,
    /// Channels of what goes out, where a convolution makes it.
    pub output: Option<usize>,
}

/// The decoder or a head.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StackLayout {
    /// From small to large maps.
    pub levels: Vec<Level>,
}

impl StackLayout {
    /// Of the stack `name`; `None` if there is none of that name.
    pub fn in_checkpoint(shapes: &Shapes, name: &str) -> Option<Self> {
        let shape = |part: &str| shapes.get(&format!("{name}.{part}.weight"));
        let side = |part: &str, axis: usize| shape(part).and_then(|shape| shape.get(axis)).copied();
        let mut levels = Vec::new();
        let mut below = None;
        for i in 0.. {
            let input = side(&format!("input_blocks.{i}"), 1);
            let width = side(&format!("input_blocks.{i}"), 0).or(below);
            let Some(width) = width.or_else(|| side(&format!("res_blocks.{i}.0.conv1"), 1)) else {
                break;
            };
            let blocks = (0..)
                .map_while(|j| side(&format!("res_blocks.{i}.{j}.conv1"), 0))
                .collect();
            let transposed = shape(&format!("resamplers.{i}.transposed")).is_some();
            levels.push(Level {
                input,
                width,
                blocks,
                up: if transposed {
                    Up::Transposed
                } else {
                    Up::Bilinear
                },
                output: side(&format!("output_blocks.{i}"), 0),
            });
            below = side(&format!("resamplers.{i}.conv"), 0);
            if below.is_none() {
                break;
            }
        }
        (!levels.is_empty()).then_some(Self { levels })
    }

    /// Channels of what the levels give away.
    fn outputs(&self) -> impl Iterator<Item = usize> {
        self.levels
            .iter()
            .map(|level| level.output.unwrap_or(level.width))
    }
}

/// The whole network, but for the backbone.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    /// Channels of the encoder's map.
    pub encoder: usize,
    /// Blocks of the backbone that are tapped.
    pub taps: usize,
    pub neck: StackLayout,
    pub points: StackLayout,
    pub mask: StackLayout,
    /// Channels of the layers of the head for scale, its input first.
    pub scale: Vec<usize>,
}

/// The most channels that anything may have, far beyond what was published.
const MOST_CHANNELS: usize = 1 << 14;

impl Layout {
    /// Of a checkpoint with `shapes` (by the names of fields).
    pub fn in_checkpoint(shapes: &Shapes) -> Result<Self, String> {
        let wide = shapes
            .iter()
            .find(|(_, shape)| shape.iter().any(|&n| n > MOST_CHANNELS));
        if let Some((name, shape)) = wide {
            return Err(format!(
                "{name} has the shape {shape:?}, which is too large"
            ));
        }
        let stack = |name: &str| {
            let stack = StackLayout::in_checkpoint(shapes, name);
            stack.ok_or_else(|| format!("{name} has no level"))
        };
        let projection = shapes.get("encoder.output_projections.0.weight");
        let scale_layer = |i: usize| shapes.get(&format!("scale_head.layers.{i}.weight"));
        let mut scale: Vec<usize> = Vec::new();
        for shape in (0..).map_while(scale_layer) {
            if scale.is_empty() {
                scale.extend(shape.get(1));
            }
            scale.extend(shape.first());
        }
        let layout = Self {
            encoder: projection
                .and_then(|shape| shape.first())
                .copied()
                .ok_or("encoder.output_projections is missing")?,
            taps: Self::taps_of(shapes),
            neck: stack("neck")?,
            points: stack("points_head")?,
            mask: stack("mask_head")?,
            scale,
        };
        layout.check()?;
        Ok(layout)
    }

    /// Blocks of the backbone that a checkpoint with `shapes` taps.
    pub fn taps_of(shapes: &Shapes) -> usize {
        let projection =
            |i: &usize| shapes.contains_key(&format!("encoder.output_projections.{i}.weight"));
        (0..).take_while(projection).count()
    }

    /// Every level takes what it is given.
    fn check(&self) -> Result<(), String> {
        let first = |i: usize| if i == 0 { self.encoder } else { 0 };
        fits(
            "neck",
            &self.neck,
            (0..self.neck.levels.len()).map(|i| Some(first(i) + 2)),
        )?;
        for (name, head, channels) in [
            ("points_head", &self.points, 3),
            ("mask_head", &self.mask, 1),
        ] {
            let inputs = self.neck.outputs().zip(&head.levels);
            // without a convolution, the input is added as it is
            fits(
                name,
                head,
                inputs.map(|(n, level)| (level.input.is_some() || n != level.width).then_some(n)),
            )?;
            if head.levels.len() != self.neck.levels.len()
                || head.outputs().last() != Some(channels)
            {
                return Err(format!(
                    "{name} does not end in {channels} channels of the last level of the neck"
                ));
            }
        }
        if self.scale.len() < 2 || self.scale.last() != Some(&1) {
            return Err(format!(
                "scale_head has the layers {:?}, which do not end in a number",
                self.scale
            ));
        }
        Ok(())
    }
}

/// Fails unless the levels of `stack` take `inputs`.
fn fits(
    name: &str,
    stack: &StackLayout,
    inputs: impl Iterator<Item = Option<usize>>,
) -> Result<(), String> {
    for (i, (level, input)) in stack.levels.iter().zip(inputs).enumerate() {
        if level.input != input {
            return Err(format!(
                "{name}.input_blocks.{i} takes {:?} channels where there are {input:?}",
                level.input
            ));
        }
    }
    Ok(())
}

/// What a checkpoint says of itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// Blocks of the backbone that are tapped, counted from 0.
    pub taps: Vec<usize>,
    /// Least and most patches that it was trained with.
    pub tokens: (usize, usize),
}

impl Config {
    /// Of a backbone of `size`: four blocks at equal distances, the last among them, 1200 to 3600
    /// patches. The published training configuration is that of the large one, whose blocks are 5,
    /// 11, 17 and 23.
    pub fn published(size: BackboneSize) -> Self {
        Self {
            taps: (1..=4).map(|i| i * size.depth() / 4 - 1).collect(),
            tokens: (1200, 3600),
        }
    }

    /// That of the checkpoint at `path`, where it has one: the official ones are a dictionary of
    /// `model_config` and `model`.
    pub fn of_checkpoint(path: &Path, size: BackboneSize) -> Result<Self, String> {
        let mut config = Self::published(size);
        if path.extension().is_some_and(|end| end == "safetensors") {
            return Ok(config);
        }
        // a file without that key is a plain list of tensors; one that cannot be read fails when
        // its tensors are
        if let Ok(stored) = PytorchReader::read_pickle_data(path, Some("model_config")) {
            config
                .read(&stored)
                .map_err(|reason| format!("of its model_config, {reason}"))?;
        }
        Ok(config)
    }

    /// Takes over what `stored` has.
    pub(super) fn read(&mut self, stored: &PickleValue) -> Result<(), String> {
        if let Some(layers) =
            entry(stored, "encoder").and_then(|encoder| entry(encoder, "intermediate_layers"))
        {
            self.taps = match layers {
                PickleValue::List(_) => {
                    numbers(layers).ok_or("intermediate_layers are not block numbers")?
                }
                _ => return Err("intermediate_layers are no list of blocks".into()),
            };
        }
        if let Some(range) = entry(stored, "num_tokens_range") {
            let range = numbers(range).filter(|r| r.len() == 2 && 0 < r[0] && r[0] <= r[1]);
            let range = range.ok_or("num_tokens_range is not two rising numbers")?;
            self.tokens = (range[0], range[1]);
        }
        if let Some(remap) = entry(stored, "remap_output").filter(|&name| text(name) != Some("exp"))
        {
            return Err(format!("remap_output = {remap:?} is not known"));
        }
        for stack in ["neck", "points_head", "mask_head"] {
            if let Some(stored) = entry(stored, stack) {
                check_stack(stored).map_err(|reason| format!("{stack}: {reason}"))?;
            }
        }
        Ok(())
    }
}

/// Fails if a stack has an unknown activation or resampler, which its tensors cannot tell.
fn check_stack(stored: &PickleValue) -> Result<(), String> {
    if let Some(activation) = entry(stored, "activation").filter(|&name| text(name) != Some("relu"))
    {
        return Err(format!("activation = {activation:?} is not known"));
    }
    let ups = match entry(stored, "resamplers") {
        Some(PickleValue::List(ups)) => ups.as_slice(),
        Some(one) => std::slice::from_ref(one),
        None => &[],
    };
    let is_known = |up: &&PickleValue| matches!(text(up), Some("conv_transpose" | "bilinear"));
    if let Some(up) = ups.iter().find(|up| !is_known(up)) {
        return Err(format!("resamplers of {up:?} are not known"));
    }
    Ok(())
}

fn entry<'a>(value: &'a PickleValue, key: &str) -> Option<&'a PickleValue> {
    match value {
        PickleValue::Dict(entries) => entries
            .get(key)
            .filter(|value| **value != PickleValue::None),
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
    let PickleValue::List(values) = value else {
        return None;
    };
    let number = |value: &PickleValue| match value {
        PickleValue::Int(n) => usize::try_from(*n).ok(),
        _ => None,
    };
    values.iter().map(number).collect()
}
