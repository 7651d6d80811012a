//! The header of a scene file, and arrays that are copied between memory and files, little-endian, in pieces.

use super::convert::Sources;
use m4_core::{SplatLayout, StateTensor};
use safetensors::tensor::Dtype;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Numbers that are turned into bytes at once: enough to keep writing fast, little beside the arrays.
const PIECE: usize = 16_384;

/// An array to write, from where it lies.
#[derive(Debug, Clone)]
pub enum Source<'a> {
    /// As it is.
    Array(StateTensor<'a>),
    /// Columns of the same length woven together: element `[row, column]`. The shape may split the
    /// second axis up.
    Woven { shape: Vec<usize>, columns: &'a [Vec<f32>] },
}

impl Source<'_> {
    pub fn dtype(&self) -> Dtype {
        match self {
            Self::Array(StateTensor::F32 { .. }) | Self::Woven { .. } => Dtype::F32,
            Self::Array(StateTensor::U32 { .. }) => Dtype::U32,
            Self::Array(StateTensor::U8 { .. }) => Dtype::U8,
            Self::Array(StateTensor::F64 { .. }) => Dtype::F64,
        }
    }

    pub fn shape(&self) -> &[usize] {
        match self {
            Self::Array(array) => array.shape(),
            Self::Woven { shape, .. } => shape,
        }
    }

    /// Size of the array in a file.
    pub fn bytes(&self) -> usize {
        let numbers = match self {
            Self::Array(array) => array.len(),
            Self::Woven { columns, .. } => columns.iter().map(Vec::len).sum(),
        };
        numbers * self.dtype().bitsize() / 8
    }

    /// Type and shape, for messages and the checksum.
    pub fn describe(&self) -> String {
        describe(self.dtype(), self.shape())
    }

    /// Hands over the bytes of the array, piece by piece.
    ///
    /// # Errors
    ///
    /// Those of `take`.
    pub fn pieces<E>(&self, mut take: impl FnMut(&[u8]) -> Result<(), E>) -> Result<(), E> {
        let mut buffer = Vec::new();
        match self {
            Self::Array(StateTensor::F32 { data, .. }) => numbers(data, |v| v.to_le_bytes(), &mut buffer, &mut take),
            Self::Array(StateTensor::U32 { data, .. }) => numbers(data, |v| v.to_le_bytes(), &mut buffer, &mut take),
            Self::Array(StateTensor::F64 { data, .. }) => numbers(data, |v| v.to_le_bytes(), &mut buffer, &mut take),
            Self::Array(StateTensor::U8 { data, .. }) => take(data),
            Self::Woven { columns, .. } => {
                let rows = columns.first().map_or(0, Vec::len);
                let step = (PIECE / columns.len().max(1)).max(1);
                for start in (0..rows).step_by(step) {
                    buffer.clear();
                    for row in start..rows.min(start + step) {
                        buffer.extend(columns.iter().flat_map(|column| column[row].to_le_bytes()));
                    }
                    take(&buffer)?;
                }
                Ok(())
            }
        }
    }
}

fn numbers<T: Copy, E, const N: usize>(
    data: &[T],
    to_bytes: impl Fn(T) -> [u8; N],
    buffer: &mut Vec<u8>,
    take: &mut impl FnMut(&[u8]) -> Result<(), E>,
) -> Result<(), E> {
    for piece in data.chunks(PIECE) {
        buffer.clear();
        buffer.extend(piece.iter().flat_map(|&v| to_bytes(v)));
        take(buffer)?;
    }
    Ok(())
}

/// An array of a file; `None` for types that are not stored here.
pub fn load(dtype: Dtype, shape: &[usize], bytes: Vec<u8>) -> Option<StateTensor<'static>> {
    let shape = shape.to_vec();
    Some(match dtype {
        Dtype::F32 => StateTensor::F32 { shape, data: words(&bytes, f32::from_le_bytes) },
        Dtype::U32 => StateTensor::U32 { shape, data: words(&bytes, u32::from_le_bytes) },
        Dtype::U8 => StateTensor::U8 { shape, data: bytes.into() },
        Dtype::F64 => StateTensor::F64 { shape, data: words(&bytes, f64::from_le_bytes) },
        _ => return None,
    })
}

fn words<T: Clone, const N: usize>(bytes: &[u8], of: impl Fn([u8; N]) -> T) -> Cow<'static, [T]> {
    bytes.as_chunks::<N>().0.iter().map(|&word| of(word)).collect()
}

/// Type and shape.
pub fn describe(dtype: Dtype, shape: &[usize]) -> String {
    let name = match dtype {
        Dtype::F32 => "f32",
        Dtype::U32 => "u32",
        Dtype::U8 => "u8",
        Dtype::F64 => "f64",
        // not among those that are stored here
        _ => "other",
    };
    format!("{name} {shape:?}")
}

/// Key of the metadata of the safetensors file.
pub const KEY: &str = "minute4d_scene";
/// Version that is written, and newest that is read.
pub const VERSION: u32 = 1;

/// The JSON under [`KEY`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Header {
    pub version: u32,
    /// Hexadecimal, over [`checksum`]'s bytes.
    pub blake3: String,
    pub scene: Facts,
    /// The caller's own pairs.
    #[serde(default)]
    pub metadata: BTreeMap<String, String>,
}

/// The part of [`Header`] whose meaning a newer version may change.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Version {
    pub version: u32,
}

/// What is not an array.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Facts {
    pub isotropic: bool,
    pub sh_degree: usize,
    pub time_degree: usize,
    pub splats_static: usize,
    pub splats_dynamic: usize,
    pub background: [f32; 3],
    pub time_frames: usize,
    pub duration_s: Option<f64>,
    pub mip: bool,
    pub near: f32,
    /// Arrays `state.NAME` are there, though perhaps none.
    pub has_state: bool,
}

impl Facts {
    pub fn layout(&self) -> SplatLayout {
        SplatLayout { isotropic: self.isotropic, sh_degree: self.sh_degree, time_degree: self.time_degree }
    }
}

/// Hash of everything that the file means: facts, metadata, and name, type, shape and values of each
/// array in the order of the names. Every part is preceded by its length.
pub fn checksum(
    facts: &Facts,
    metadata: &BTreeMap<String, String>,
    arrays: &Sources<'_>,
) -> Result<String, serde_json::Error> {
    let mut hasher = blake3::Hasher::new();
    part(&mut hasher, &serde_json::to_vec(facts)?);
    part(&mut hasher, &serde_json::to_vec(metadata)?);
    for (name, array) in arrays {
        part(&mut hasher, name.as_bytes());
        part(&mut hasher, array.describe().as_bytes());
        hasher.update(&(array.bytes() as u64).to_le_bytes());
        let Ok(()) = array.pieces(|piece| {
            hasher.update(piece);
            Ok::<(), std::convert::Infallible>(())
        });
    }
    Ok(hasher.finalize().to_hex().to_string())
}

fn part(hasher: &mut blake3::Hasher, bytes: &[u8]) {
    hasher.update(&(bytes.len() as u64).to_le_bytes());
    hasher.update(bytes);
}
