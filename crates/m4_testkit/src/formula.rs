//! Synthetic weights and inputs from a formula, so that a fixture stores only outputs.
//!
//! The rule is section 1 of the README of the golden fixtures: FNV-1a of the tensor's name,
//! SplitMix64 of key and index, and a scale that follows from the name's last part and the shape.

use safetensors::{Dtype, serialize_to_file, tensor::TensorView};
use std::collections::HashMap;
use std::path::Path;

/// Numbers in [-1, 1) from the name of a tensor alone, in row-major order.
pub fn formula(name: &str, n: usize) -> impl Iterator<Item = f64> + use<> {
    let mut key = 0xCBF2_9CE4_8422_2325u64;
    for byte in name.bytes() {
        key = (key ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01B3);
    }
    (1..=n as u64).map(move |i| {
        let mut z = key.wrapping_add(i.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^= z >> 31;
        (z >> 11) as f64 * 2f64.powi(-52) - 1.0
    })
}

/// A random input that a fixture describes instead of holding it: `offset + scale u` of `n`
/// numbers.
pub fn formula_input(key: &str, offset: f64, scale: f64, n: usize) -> Vec<f32> {
    formula(key, n)
        .map(|u| (offset + scale * u) as f32)
        .collect()
}

/// A checkpoint by the rule.
#[derive(Debug, Clone)]
pub struct FormulaWeights {
    tensors: Vec<FormulaTensor>,
}

#[derive(Debug, Clone)]
struct FormulaTensor {
    name: String,
    shape: Vec<usize>,
    /// `None` for the counters of training, which are whole numbers.
    values: Option<Vec<f32>>,
}

impl FormulaWeights {
    /// Of the tensors of `list`: lines of a name and a shape, separated by spaces. A constant of
    /// the official module that the rule leaves alone (`image_mean`, `image_std`) is that of
    /// ImageNet.
    pub fn of_keys(list: &str) -> Self {
        let tensor = |line: &str| {
            let mut words = line.split_whitespace();
            let name = words
                .next()
                .expect("a line is a name and a shape")
                .to_owned();
            let shape: Vec<usize> = words
                .map(|w| w.parse().expect("a shape is numbers"))
                .collect();
            let values = (!name.ends_with(".num_batches_tracked")).then(|| fill(&name, &shape));
            FormulaTensor {
                name,
                shape,
                values,
            }
        };
        Self {
            tensors: list.lines().map(tensor).collect(),
        }
    }

    fn at(&mut self, name: &str) -> &mut Vec<f32> {
        let tensor = self.tensors.iter_mut().find(|t| t.name == name);
        let values = tensor.and_then(|t| t.values.as_mut());
        values.unwrap_or_else(|| panic!("there is no tensor {name}"))
    }

    /// Puts `values` instead of those of `name`.
    pub fn with(mut self, name: &str, values: &[f32]) -> Self {
        let tensor = self.at(name);
        assert_eq!(tensor.len(), values.len(), "{name}");
        tensor.copy_from_slice(values);
        self
    }

    /// Multiplies the values of `name`, in 32 bits.
    pub fn scaled(mut self, name: &str, factor: f32) -> Self {
        self.at(name).iter_mut().for_each(|x| *x *= factor);
        self
    }

    /// Multiplies each of the values of `name`, in 32 bits, by what `factor` says of its row-major
    /// index.
    pub fn scaled_by(mut self, name: &str, factor: impl Fn(usize) -> f32) -> Self {
        let values = self.at(name).iter_mut().enumerate();
        values.for_each(|(i, x)| *x *= factor(i));
        self
    }

    /// Writes a safetensors file.
    pub fn write(&self, path: &Path) {
        self.write_with(None, path);
    }

    /// Writes a safetensors file whose metadata has one entry, a name and its text, or none.
    pub fn write_with(&self, metadata: Option<(&str, &str)>, path: &Path) {
        let bytes: Vec<(Dtype, Vec<u8>)> = self.tensors.iter().map(FormulaTensor::bytes).collect();
        let views = self.tensors.iter().zip(&bytes).map(|(t, (dtype, bytes))| {
            let view =
                TensorView::new(*dtype, t.shape.clone(), bytes).expect("shape and values fit");
            (t.name.as_str(), view)
        });
        let metadata =
            metadata.map(|(name, text)| HashMap::from([(name.to_owned(), text.to_owned())]));
        serialize_to_file(views, metadata, path).expect("the checkpoint can be written");
    }
}

impl FormulaTensor {
    fn bytes(&self) -> (Dtype, Vec<u8>) {
        match &self.values {
            Some(values) => (
                Dtype::F32,
                (values.iter().map(|v| v.to_le_bytes()).collect::<Vec<_>>()).into_flattened(),
            ),
            None => (Dtype::I64, 7i64.to_le_bytes().to_vec()),
        }
    }
}

/// Writes a checkpoint of the tensors of `list` as [`FormulaWeights::of_keys`] reads it.
pub fn write_formula_weights(list: &str, path: &Path) {
    FormulaWeights::of_keys(list).write(path);
}

fn fill(name: &str, shape: &[usize]) -> Vec<f32> {
    let last = name.rsplit('.').next().unwrap_or(name);
    let numbers = shape.iter().product();
    let constant = |values: [f32; 3]| values.to_vec();
    match last {
        "image_mean" => return constant([0.485, 0.456, 0.406]),
        "image_std" => return constant([0.229, 0.224, 0.225]),
        _ => {}
    }
    let fan_in: usize = shape.iter().skip(1).product();
    // Chosen once: tensors have up to tens of millions of numbers.
    let (offset, scale) = match (last, shape.len()) {
        ("running_mean", _) => (0.0, 0.1),
        ("running_var", _) => (1.0, 0.2),
        ("gamma" | "layer_scale", _) => (0.5, 0.1),
        ("positional_encoding_gaussian_matrix", _) => (0.0, 1.0),
        (l, _) if l.ends_with("bias") => (0.0, 0.02),
        (l, 1) if l.ends_with("weight") => (1.0, 0.1),
        (l, 2..) if l.ends_with("weight") => (0.0, (3.0 / fan_in as f64).sqrt()),
        _ => (0.0, 0.5),
    };
    let numbers = formula(name, numbers);
    match last {
        "running_var" => numbers.map(|u| (offset + scale * u.abs()) as f32).collect(),
        _ => numbers.map(|u| (offset + scale * u) as f32).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::fill;

    /// The worked example of the rule.
    #[test]
    fn first_values() {
        let conv = fill("fnet.conv1.weight", &[32, 3, 7, 7]);
        let bits: Vec<u32> = conv[..3].iter().map(|x| x.to_bits()).collect();
        assert_eq!(bits, [0x3d59_58f5, 0xbd3e_e038, 0xbe05_040e]);
        // printed with eight digits
        let near =
            |got: &[f32], want: [f32; 2]| got.iter().zip(want).all(|(a, b)| (a - b).abs() < 4e-8);
        let bias = fill("fnet.conv1.bias", &[32]);
        assert!(
            near(&bias[..2], [-0.017_122_697, -0.008_338_756]),
            "{:?}",
            &bias[..2]
        );
        let norm = fill("pretrained.blocks.0.norm1.weight", &[384]);
        assert!(
            near(&norm[..2], [0.909_698_5, 1.038_620_7]),
            "{:?}",
            &norm[..2]
        );
        let position = fill("pretrained.pos_embed", &[1, 1370, 384]);
        assert!(
            near(&position[..2], [0.292_686_97, -0.041_432_94]),
            "{:?}",
            &position[..2]
        );
    }
}
