//! Named arrays from an archive or a folder.

use super::MegasamFault;
use crate::npy::{Array, Npz, Number};
use std::fs::File;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

/// Where arrays come from.
pub(super) enum Input {
    Archive(Npz),
    Folder(PathBuf),
}

impl Input {
    pub fn open(path: &Path) -> Result<Self, MegasamFault> {
        if path.is_dir() {
            return Ok(Self::Folder(path.to_path_buf()));
        }
        let npz = Npz::open(path).map_err(MegasamFault::Io)?;
        npz.map(Self::Archive).map_err(MegasamFault::Archive)
    }

    /// An array, its header read; `None` if it is missing.
    pub fn find(&mut self, name: &'static str, limit_bytes: u64) -> Result<Option<Array<'_>>, MegasamFault> {
        match self {
            Self::Archive(npz) => npz.array(name, limit_bytes).map_err(MegasamFault::of(name)),
            Self::Folder(folder) => {
                let path = folder.join(format!("{name}.npy"));
                match file(&path, name, limit_bytes) {
                    Err(MegasamFault::Io(e)) if e.kind() == io::ErrorKind::NotFound => Ok(None),
                    other => other.map(Some),
                }
            }
        }
    }

    /// An array that must be there.
    pub fn array(&mut self, name: &'static str, limit_bytes: u64) -> Result<Array<'_>, MegasamFault> {
        let has = match self {
            Self::Archive(npz) => format!(
                "it has {}; images, depths, intrinsic and cam_c2w are needed",
                npz.names()
            ),
            Self::Folder(_) => "images.npy, disps.npy, poses.npy and intrinsics.npy are needed".to_owned(),
        };
        let found = self.find(name, limit_bytes)?;
        found.ok_or(MegasamFault::Missing { array: name, has })
    }
}

/// The array of a `.npy` file, its header read.
pub(super) fn file(path: &Path, name: &'static str, limit_bytes: u64) -> Result<Array<'static>, MegasamFault> {
    let open = File::open(path).map_err(MegasamFault::Io)?;
    let bytes = open.metadata().map_err(MegasamFault::Io)?.len();
    Array::open(BufReader::new(open), bytes, limit_bytes).map_err(MegasamFault::of(name))
}

/// Refuses an array of another shape; `expected` says what it is.
pub(super) fn shape(name: &'static str, array: &Array<'_>, expected: &[usize], is: &str) -> Result<(), MegasamFault> {
    if array.shape == expected {
        return Ok(());
    }
    Err(MegasamFault::Shape {
        array: name,
        found: array.shape.clone(),
        expected: format!("{is} = {expected:?}"),
    })
}

/// Refuses an array of whole numbers where fractions are needed, or the other way round.
pub(super) fn numbers(name: &'static str, array: &Array<'_>, whole: bool) -> Result<(), MegasamFault> {
    let fits = match array.number {
        Number::U8 => whole,
        Number::F16 | Number::F32 | Number::F64 => !whole,
        _ => false,
    };
    if fits {
        return Ok(());
    }
    let wanted = if whole { "uint8" } else { "float16, float32 or float64" };
    Err(MegasamFault::Array {
        array: name,
        reason: format!("holds numbers of type {:?}; save it as {wanted}", array.number),
    })
}

/// All numbers of an array that is not large.
pub(super) fn all(name: &'static str, mut array: Array<'_>) -> Result<Vec<f64>, MegasamFault> {
    let n = array.shape.iter().product();
    let values = array.next_f64(n).map_err(MegasamFault::of(name))?;
    array.end().map_err(MegasamFault::of(name))?;
    Ok(values)
}
