//! Reads small arrays of an npz archive, by any of several names.

use super::npy::{NpyFile, array_of, open_npz, present};
use crate::dataset::{ReadSourceError, SourceErrorCause};
use crate::npy::Npz;
use std::path::{Path, PathBuf};

/// Bytes of an array of poses or lenses: a quarter of a million frames.
const MAX_SMALL_BYTES: u64 = 16 << 20;

/// An archive.
pub(crate) struct Arrays {
    path: PathBuf,
    npz: Npz,
}

impl Arrays {
    pub fn open(path: &Path) -> Result<Self, ReadSourceError> {
        Ok(Self {
            path: path.to_path_buf(),
            npz: open_npz(path).map_err(|e| e.at(path))?,
        })
    }

    /// Which of the names it has; an error that lists what is there if none.
    pub fn need(&self, names: &[&'static str], hint: &str) -> Result<&'static str, ReadSourceError> {
        present(&self.npz, names).ok_or_else(|| {
            let what = format!("the array {}", names.join(" or "));
            SourceErrorCause::missing(what, format!("it has {}; {hint}", self.npz.names())).at(&self.path)
        })
    }

    /// A small array: its numbers and its shape without leading 1s beyond `rank`.
    pub fn numbers(&mut self, name: &'static str, rank: usize) -> Result<(Vec<usize>, Vec<f64>), ReadSourceError> {
        let array = array_of(&mut self.npz, name, MAX_SMALL_BYTES).and_then(NpyFile::of_array);
        let array = array.map_err(|e| e.within(&self.path, format!("array `{name}`")))?;
        Ok((unbatched(&array.shape, rank).to_vec(), array.values))
    }
}

/// The shape without leading 1s beyond `rank`: networks leave a dimension of batches.
fn unbatched(shape: &[usize], rank: usize) -> &[usize] {
    match shape {
        [1, rest @ ..] if shape.len() > rank => unbatched(rest, rank),
        all => all,
    }
}
