//! Golden fixtures of networks: tensors in safetensors files, and how near numbers are to them.

use crate::skip::repository;
use m4_core::RgbImage;
use safetensors::{Dtype, SafeTensors};
use std::fs;

/// A safetensors file of `fixtures/`.
#[derive(Debug)]
pub struct Fixture(Vec<u8>);

impl Fixture {
    /// The file `name`, a path in that folder.
    pub fn open(name: &str) -> Self {
        let path = repository().join("fixtures").join(name);
        Self(fs::read(&path).unwrap_or_else(|e| panic!("cannot read {}: {e}", path.display())))
    }

    /// Bytes, type and shape of a tensor.
    fn tensor(&self, name: &str) -> (Vec<u8>, Dtype, Vec<usize>) {
        let tensors = SafeTensors::deserialize(&self.0).expect("a safetensors file");
        let tensor = tensors
            .tensor(name)
            .unwrap_or_else(|e| panic!("{name}: {e}"));
        (
            tensor.data().to_vec(),
            tensor.dtype(),
            tensor.shape().to_vec(),
        )
    }

    /// The words of a tensor, which are of type `dtype`.
    fn words<const N: usize>(&self, name: &str, dtype: Dtype) -> (Vec<[u8; N]>, Vec<usize>) {
        let (bytes, actual, shape) = self.tensor(name);
        assert_eq!(actual, dtype, "{name}");
        (bytes.as_chunks::<N>().0.to_vec(), shape)
    }

    /// A tensor of 32-bit numbers, and its shape.
    pub fn floats(&self, name: &str) -> (Vec<f32>, Vec<usize>) {
        let (words, shape) = self.words(name, Dtype::F32);
        (words.into_iter().map(f32::from_le_bytes).collect(), shape)
    }

    /// A tensor of 64-bit numbers.
    pub fn doubles(&self, name: &str) -> Vec<f64> {
        self.words(name, Dtype::F64)
            .0
            .into_iter()
            .map(f64::from_le_bytes)
            .collect()
    }

    /// A tensor of 64-bit integers.
    pub fn indices(&self, name: &str) -> Vec<usize> {
        self.words(name, Dtype::I64)
            .0
            .into_iter()
            .map(|word| i64::from_le_bytes(word) as usize)
            .collect()
    }

    /// A tensor of 32-bit integers.
    pub fn whole(&self, name: &str) -> Vec<i32> {
        self.words(name, Dtype::I32)
            .0
            .into_iter()
            .map(i32::from_le_bytes)
            .collect()
    }

    /// A tensor of 16-bit integers.
    pub fn shorts(&self, name: &str) -> Vec<i16> {
        self.words(name, Dtype::I16)
            .0
            .into_iter()
            .map(i16::from_le_bytes)
            .collect()
    }

    /// A tensor of bytes.
    pub fn bytes(&self, name: &str) -> Vec<u8> {
        self.words::<1>(name, Dtype::U8).0.into_flattened()
    }

    /// An image of `[3, h, w]` or `[h, w, 3]` bytes.
    pub fn image(&self, name: &str) -> RgbImage {
        let (bytes, _, shape) = self.tensor(name);
        match shape[..] {
            [3, h, w] => {
                RgbImage::from_fn(w, h, |x, y| [0, 1, 2].map(|c| bytes[(c * h + y) * w + x]))
            }
            [h, w, 3] => {
                RgbImage::from_fn(w, h, |x, y| [0, 1, 2].map(|c| bytes[(y * w + x) * 3 + c]))
            }
            _ => panic!("{name} is not an image"),
        }
    }
}

/// `max |a - b| / max |b|`; there have to be as many numbers, not all of them zero, and none that
/// is not finite.
pub fn relative_error(got: &[f32], want: &[f32]) -> f64 {
    assert_eq!(got.len(), want.len(), "numbers");
    let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
    assert!(
        got.iter().chain(want).all(|x| x.is_finite()),
        "a number that is not finite"
    );
    let scale = largest(&mut want.iter().map(|&x| f64::from(x).abs()));
    assert!(scale > 0.0, "nothing but zeros is wanted");
    largest(
        &mut got
            .iter()
            .zip(want)
            .map(|(&a, &b)| (f64::from(a) - f64::from(b)).abs()),
    ) / scale
}

/// Fails unless the [relative error](relative_error) is below `limit`.
#[expect(clippy::print_stdout, reason = "figures for docs/networks.md")]
#[track_caller]
pub fn assert_close(what: &str, got: &[f32], want: &[f32], limit: f64) {
    let error = relative_error(got, want);
    println!("{what}: {error:.1e}");
    assert!(
        error < limit,
        "{what}: relative error {error:e}, limit {limit:e}"
    );
}
