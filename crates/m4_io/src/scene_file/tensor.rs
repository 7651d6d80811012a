//! Arrays between safetensors files and [`StateTensor`], little-endian.

use m4_scene::StateTensor;
use safetensors::tensor::{Dtype, View};
use std::borrow::Cow;

/// An array as the `safetensors` crate wants it.
pub struct Stored<'a>(pub &'a StateTensor);

impl View for Stored<'_> {
    fn dtype(&self) -> Dtype {
        match self.0 {
            StateTensor::F32 { .. } => Dtype::F32,
            StateTensor::U32 { .. } => Dtype::U32,
            StateTensor::U8 { .. } => Dtype::U8,
            StateTensor::F64 { .. } => Dtype::F64,
        }
    }

    fn shape(&self) -> &[usize] {
        self.0.shape()
    }

    fn data(&self) -> Cow<'_, [u8]> {
        bytes(self.0)
    }

    fn data_len(&self) -> usize {
        self.0.len() * self.dtype().bitsize() / 8
    }
}

/// The values as bytes.
pub fn bytes(tensor: &StateTensor) -> Cow<'_, [u8]> {
    match tensor {
        StateTensor::F32 { data, .. } => Cow::Owned(data.iter().flat_map(|v| v.to_le_bytes()).collect()),
        StateTensor::U32 { data, .. } => Cow::Owned(data.iter().flat_map(|v| v.to_le_bytes()).collect()),
        StateTensor::U8 { data, .. } => Cow::Borrowed(data),
        StateTensor::F64 { data, .. } => Cow::Owned(data.iter().flat_map(|v| v.to_le_bytes()).collect()),
    }
}

/// An array of a file; `None` for types that are not stored here.
pub fn load(dtype: Dtype, shape: &[usize], bytes: &[u8]) -> Option<StateTensor> {
    let shape = shape.to_vec();
    Some(match dtype {
        Dtype::F32 => StateTensor::F32 {
            shape,
            data: words(bytes).map(f32::from_le_bytes).collect(),
        },
        Dtype::U32 => StateTensor::U32 {
            shape,
            data: words(bytes).map(u32::from_le_bytes).collect(),
        },
        Dtype::U8 => StateTensor::U8 {
            shape,
            data: bytes.to_vec(),
        },
        Dtype::F64 => StateTensor::F64 {
            shape,
            data: words(bytes).map(f64::from_le_bytes).collect(),
        },
        _ => return None,
    })
}

fn words<const N: usize>(bytes: &[u8]) -> impl Iterator<Item = [u8; N]> {
    bytes.as_chunks::<N>().0.iter().copied()
}

/// Type and shape, for messages.
pub fn describe(tensor: &StateTensor) -> String {
    let name = match tensor {
        StateTensor::F32 { .. } => "f32",
        StateTensor::U32 { .. } => "u32",
        StateTensor::U8 { .. } => "u8",
        StateTensor::F64 { .. } => "f64",
    };
    format!("{name} {:?}", tensor.shape())
}
