//! The header of a scene file, and arrays that are copied between memory and files, little-endian,
//! in pieces.

use crate::{Fault, shortened};
use m4_core::{Column, SplatLayout, Splats, StateTensor};
use safetensors::tensor::Dtype;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Numbers that are turned into bytes at once: enough to keep writing fast, little beside the
/// arrays.
const PIECE: usize = 16_384;

/// An array to write, from where it lies.
#[derive(Debug, Clone)]
pub enum Source<'a> {
    /// As it is.
    Array(StateTensor<'a>),
    /// Columns of the same length woven together: element `[row, column]`. The shape may split the
    /// second axis up.
    Woven {
        shape: Vec<usize>,
        columns: &'a [Vec<f32>],
    },
}

impl Source<'_> {
    pub fn dtype(&self) -> Dtype {
        match self {
            Self::Array(StateTensor::F32 { .. }) | Self::Woven { .. } => Dtype::F32,
            Self::Array(StateTensor::U32 { .. }) => Dtype::U32,
            Self::Array(StateTensor::U16 { .. }) => Dtype::U16,
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
    pub fn pieces<E>(&self, mut take: impl FnMut(&[u8]) -> Result<(), E>) -> Result<(), E> {
        let mut buffer = Vec::new();
        match self {
            Self::Array(StateTensor::F32 { data, .. }) => {
                numbers(data, |v| v.to_le_bytes(), &mut buffer, &mut take)
            }
            Self::Array(StateTensor::U32 { data, .. }) => {
                numbers(data, |v| v.to_le_bytes(), &mut buffer, &mut take)
            }
            Self::Array(StateTensor::F64 { data, .. }) => {
                numbers(data, |v| v.to_le_bytes(), &mut buffer, &mut take)
            }
            Self::Array(StateTensor::U16 { data, .. }) => {
                numbers(data, |v| v.to_le_bytes(), &mut buffer, &mut take)
            }
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
        Dtype::U16 => StateTensor::U16 {
            shape,
            data: words(&bytes, u16::from_le_bytes),
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
    bytes
        .as_chunks::<N>()
        .0
        .iter()
        .map(|&word| of(word))
        .collect()
}

/// Type and shape.
pub fn describe(dtype: Dtype, shape: &[usize]) -> String {
    let name = match dtype {
        Dtype::F32 => "f32",
        Dtype::U32 => "u32",
        Dtype::U16 => "u16",
        Dtype::U8 => "u8",
        Dtype::F64 => "f64",
        // not among those that are stored here
        _ => "other",
    };
    format!("{name} {shape:?}")
}

/// Key of the metadata of the safetensors file.
pub const KEY: &str = "minute4d_scene";
/// Version of files without windows and bindings.
pub const UNBOUND_VERSION: u32 = 1;
/// Version of files with them, and newest that is read.
pub const VERSION: u32 = 2;

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
    /// Bound splats, where there are windows or bindings; the file is of [`VERSION`] then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub splats_bound: Option<usize>,
}

impl Facts {
    pub fn layout(&self) -> SplatLayout {
        SplatLayout {
            isotropic: self.isotropic,
            sh_degree: self.sh_degree,
            time_degree: self.time_degree,
        }
    }
}

/// Hash of everything that the file means: facts, metadata, and name, type, shape and values of
/// each array in the order of the names. Every part is preceded by its length.
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

/// Named arrays of a file.
pub type Arrays = BTreeMap<String, StateTensor<'static>>;
/// Named arrays to write.
pub type Sources<'a> = BTreeMap<String, Source<'a>>;

/// The columns of splats, with their names in files; the last, [`Column::Trend`], is with the
/// bindings.
const COLUMNS: [(Column, &str); 8] = [
    (Column::Mean, "splats.mean"),
    (Column::LogScale, "splats.log_scale"),
    (Column::Quat, "splats.quat"),
    (Column::Opacity, "splats.opacity"),
    (Column::Colour, "splats.colour"),
    (Column::TimeMean, "splats.time_mean"),
    (Column::LogTimeSd, "splats.log_time_sd"),
    (Column::Velocity, "splats.velocity"),
];

/// Shape of the array of a parameter with `rows` splats.
fn shape(layout: SplatLayout, column: Column, rows: usize) -> Vec<usize> {
    match column {
        Column::Opacity | Column::TimeMean | Column::LogTimeSd => vec![rows],
        Column::Colour => vec![rows, layout.time_degree + 1, layout.sh_terms(), 3],
        _ => vec![rows, layout.range(column).len()],
    }
}

/// True for the parameters that static splats do not have.
fn is_dynamic(column: Column) -> bool {
    matches!(
        column,
        Column::TimeMean | Column::LogTimeSd | Column::Velocity
    )
}

/// The arrays of splats: rows are splats, so the columns are woven together.
pub fn splats_to_arrays<'a>(splats: &'a Splats, arrays: &mut Sources<'a>) {
    let layout = splats.layout();
    for (column, name) in COLUMNS {
        let columns = &splats.columns()[layout.range(column)];
        if columns.is_empty() {
            continue;
        }
        let rows = if is_dynamic(column) {
            splats.n_dynamic()
        } else {
            splats.n()
        };
        let shape = shape(layout, column, rows);
        arrays.insert(name.to_owned(), Source::Woven { shape, columns });
    }
}

/// The splats of arrays, which are taken out one by one.
pub fn arrays_to_splats(
    arrays: &mut Arrays,
    layout: SplatLayout,
    n_static: usize,
    n_dynamic: usize,
) -> Result<Splats, Fault> {
    let mut columns = Vec::with_capacity(layout.columns());
    let total = n_static.saturating_add(n_dynamic);
    for (column, name) in COLUMNS {
        let width = layout.range(column).len();
        if width == 0 {
            continue;
        }
        let rows = if is_dynamic(column) { n_dynamic } else { total };
        let data = f32_array(arrays, name, &shape(layout, column, rows))?;
        columns.extend((0..width).map(|c| {
            data.iter()
                .skip(c)
                .step_by(width)
                .copied()
                .collect::<Vec<f32>>()
        }));
        arrays.remove(name);
    }
    columns.extend((0..layout.range(Column::Trend).len()).map(|_| vec![0.0; n_dynamic]));
    // Every length was compared above, so this cannot fail.
    Splats::from_columns(layout, n_static, n_dynamic, columns)
        .map_err(|e| Fault::damaged(format!("its splats are {e}")))
}

fn other(name: &str, tensor: &StateTensor<'_>, kind: &str, shape: &[usize]) -> Fault {
    let actual = Source::Array(tensor.view()).describe();
    let name = shortened(format!("{name:?}"));
    Fault::damaged(format!(
        "array {name} is {actual} where {kind} {shape:?} was expected"
    ))
}

fn missing(name: &str) -> Fault {
    Fault::damaged(format!(
        "it has no array {}",
        shortened(format!("{name:?}"))
    ))
}

/// The values of an array that must have a type and shape.
pub fn f32_array<'a>(arrays: &'a Arrays, name: &str, shape: &[usize]) -> Result<&'a [f32], Fault> {
    match arrays.get(name) {
        Some(StateTensor::F32 { shape: dims, data }) if dims == shape => Ok(data),
        Some(tensor) => Err(other(name, tensor, "f32", shape)),
        None => Err(missing(name)),
    }
}

pub fn u32_array<'a>(arrays: &'a Arrays, name: &str, shape: &[usize]) -> Result<&'a [u32], Fault> {
    match arrays.get(name) {
        Some(StateTensor::U32 { shape: dims, data }) if dims == shape => Ok(data),
        Some(tensor) => Err(other(name, tensor, "u32", shape)),
        None => Err(missing(name)),
    }
}

pub fn u16_array<'a>(arrays: &'a Arrays, name: &str, shape: &[usize]) -> Result<&'a [u16], Fault> {
    match arrays.get(name) {
        Some(StateTensor::U16 { shape: dims, data }) if dims == shape => Ok(data),
        Some(tensor) => Err(other(name, tensor, "u16", shape)),
        None => Err(missing(name)),
    }
}

pub fn f64_array<'a>(arrays: &'a Arrays, name: &str, shape: &[usize]) -> Result<&'a [f64], Fault> {
    match arrays.get(name) {
        Some(StateTensor::F64 { shape: dims, data }) if dims == shape => Ok(data),
        Some(tensor) => Err(other(name, tensor, "f64", shape)),
        None => Err(missing(name)),
    }
}
