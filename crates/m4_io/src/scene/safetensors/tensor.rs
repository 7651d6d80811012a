//! The header of a scene file, and arrays that are copied between memory and files, little-endian,
//! in pieces.

use crate::{Fault, shortened};
use m4_core::nalgebra::{Matrix3, Vector3};
use m4_core::{
    Camera, Column, Exposure, Intrinsics, Se3, SourceFrame, SplatLayout, Splats, StateTensor,
};
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

/// Deviations of distances, 0 where there is none; the array is absent where no frame has one.
const SIGMA: &str = "source.distance_sigma";

/// The arrays of the training cameras.
pub fn source_to_arrays(source: &[SourceFrame], arrays: &mut Sources<'_>) {
    let n = source.len();
    let lens = |f: &SourceFrame| {
        let k = f.camera.intrinsics;
        [k.width as f64, k.height as f64, k.fx, k.fy, k.cx, k.cy]
    };
    let pose = |f: &SourceFrame| -> [f64; 12] {
        let Se3 {
            rotation,
            translation,
        } = f.camera.c2w;
        std::array::from_fn(|i| {
            if i % 4 == 3 {
                translation[i / 4]
            } else {
                rotation[(i / 4, i % 4)]
            }
        })
    };
    let exposure = |f: &SourceFrame| -> [f32; 12] {
        let Exposure { matrix, offset } = f.exposure;
        std::array::from_fn(|i| {
            if i % 4 == 3 {
                offset[i / 4]
            } else {
                matrix[i / 4][i % 4]
            }
        })
    };
    let f64s = |shape: Vec<usize>, data: Vec<f64>| {
        let data = data.into();
        Source::Array(StateTensor::F64 { shape, data })
    };
    arrays.insert(
        "source.intrinsics".into(),
        f64s(vec![n, 6], source.iter().flat_map(lens).collect()),
    );
    arrays.insert(
        "source.c2w".into(),
        f64s(vec![n, 3, 4], source.iter().flat_map(pose).collect()),
    );
    arrays.insert(
        "source.t".into(),
        f64s(vec![n], source.iter().map(|f| f.t).collect()),
    );
    let data = source.iter().flat_map(exposure).collect();
    arrays.insert(
        "source.exposure".into(),
        Source::Array(StateTensor::F32 {
            shape: vec![n, 3, 4],
            data,
        }),
    );
    if source.iter().any(|f| f.distance_sigma.is_some()) {
        let sigma = |f: &SourceFrame| f.distance_sigma.unwrap_or(0.0);
        let data = source.iter().map(sigma).collect();
        let shape = vec![n];
        arrays.insert(
            SIGMA.into(),
            Source::Array(StateTensor::F32 { shape, data }),
        );
    }
}

/// The training cameras of arrays.
pub fn arrays_to_source(arrays: &Arrays) -> Result<Vec<SourceFrame>, Fault> {
    let n = arrays.get("source.t").map_or(0, StateTensor::len);
    let t = f64_array(arrays, "source.t", &[n])?;
    let lens = f64_array(arrays, "source.intrinsics", &[n, 6])?
        .as_chunks::<6>()
        .0;
    let pose = f64_array(arrays, "source.c2w", &[n, 3, 4])?
        .as_chunks::<12>()
        .0;
    let exposure = f32_array(arrays, "source.exposure", &[n, 3, 4])?
        .as_chunks::<12>()
        .0;
    let sigma = match arrays.contains_key(SIGMA) {
        true => f32_array(arrays, SIGMA, &[n])?,
        false => &[],
    };
    let frame = |i: usize| {
        let [width, height, fx, fy, cx, cy] = lens[i];
        let (p, e) = (&pose[i], &exposure[i]);
        SourceFrame {
            camera: Camera {
                intrinsics: Intrinsics {
                    // A cast from float saturates.
                    width: width as usize,
                    height: height as usize,
                    fx,
                    fy,
                    cx,
                    cy,
                },
                c2w: Se3 {
                    rotation: Matrix3::from_fn(|r, c| p[4 * r + c]),
                    translation: Vector3::from_fn(|r, _| p[4 * r + 3]),
                },
            },
            t: t[i],
            exposure: Exposure {
                matrix: std::array::from_fn(|r| std::array::from_fn(|c| e[4 * r + c])),
                offset: std::array::from_fn(|r| e[4 * r + 3]),
            },
            distance_sigma: sigma.get(i).copied().filter(|&s| s != 0.0),
        }
    };
    Ok((0..n).map(frame).collect())
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

fn f64_array<'a>(arrays: &'a Arrays, name: &str, shape: &[usize]) -> Result<&'a [f64], Fault> {
    match arrays.get(name) {
        Some(StateTensor::F64 { shape: dims, data }) if dims == shape => Ok(data),
        Some(tensor) => Err(other(name, tensor, "f64", shape)),
        None => Err(missing(name)),
    }
}
