//! Copies arrays between memory and safetensors files, little-endian, in pieces.

use m4_core::StateTensor;
use safetensors::tensor::Dtype;
use std::borrow::Cow;

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
        Dtype::F32 => StateTensor::F32 {
            shape,
            data: words(&bytes, f32::from_le_bytes),
        },
        Dtype::U32 => StateTensor::U32 {
            shape,
            data: words(&bytes, u32::from_le_bytes),
        },
        Dtype::U8 => StateTensor::U8 {
            shape,
            data: bytes.into(),
        },
        Dtype::F64 => StateTensor::F64 {
            shape,
            data: words(&bytes, f64::from_le_bytes),
        },
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
