//! Reads arrays in `.npy` files, and archives of them.

use crate::dataset::SourceErrorCause;
use crate::npy::{Array, ArrayError, Npz, Number};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// The numbers of a whole `.npy` file.
pub(crate) struct NpyFile {
    /// Slowest dimension first.
    pub shape: Vec<usize>,
    /// In C order.
    pub values: Vec<f64>,
    /// Whether the file holds integers.
    pub whole_numbers: bool,
}

impl NpyFile {
    /// Reads it; in memory it may take `limit_bytes`.
    pub(crate) fn read(path: &Path, limit_bytes: u64) -> Result<Self, SourceErrorCause> {
        let file = File::open(path)?;
        let file_bytes = file.metadata()?.len();
        // in memory each number takes 8 bytes, in the file 1 at least
        let array = Array::open(BufReader::new(file), file_bytes, limit_bytes / 8);
        Self::of_array(array.map_err(|e| array_error("the array", e))?)
    }

    /// Reads an array to its end.
    pub(crate) fn of_array(mut array: Array<'_>) -> Result<Self, SourceErrorCause> {
        let n = array.shape.iter().product();
        let values = array.next_f64(n).map_err(|e| array_error("the array", e))?;
        array.end().map_err(|e| array_error("the array", e))?;
        Ok(Self {
            whole_numbers: !is_float(&array),
            shape: array.shape,
            values,
        })
    }

    /// Height and width of one map, `[h][w]`, also with dimensions of 1 around.
    pub(crate) fn map_size(&self) -> Result<(usize, usize), SourceErrorCause> {
        match self.shape[..] {
            [h, w] | [h, w, 1] | [1, h, w] | [1, h, w, 1] if h * w > 0 => Ok((h, w)),
            _ => {
                let what = format!("an array of shape {:?}; [height, width] was expected", self.shape);
                Err(SourceErrorCause::bad(what, "save one map per file"))
            }
        }
    }
}

/// Opens an archive of arrays.
pub(crate) fn open_npz(path: &Path) -> Result<Npz, SourceErrorCause> {
    Npz::open(path)?.map_err(|reason| {
        let what = format!("it is not an npz archive of arrays, or a damaged one ({reason})");
        SourceErrorCause::bad(what, "give the npz file that the tool wrote, whole")
    })
}

/// The first of `keys` that the archive has.
pub(crate) fn present<'k>(npz: &Npz, keys: &[&'k str]) -> Option<&'k str> {
    keys.iter().copied().find(|key| npz.has(key))
}

/// The array of that name, which is there; `limit_bytes` as for [`Npz::array`].
pub(crate) fn array_of<'a>(npz: &'a mut Npz, key: &str, limit_bytes: u64) -> Result<Array<'a>, SourceErrorCause> {
    let array = npz.array(key, limit_bytes).map_err(|e| array_error(key, e))?;
    array.ok_or_else(|| SourceErrorCause::missing(key, "save it again"))
}

/// Whether its numbers are floats.
pub(crate) fn is_float(array: &Array<'_>) -> bool {
    matches!(array.number, Number::F16 | Number::F32 | Number::F64)
}

/// Why `what` cannot be read.
pub(crate) fn array_error(what: &str, cause: ArrayError) -> SourceErrorCause {
    match cause {
        ArrayError::Bad(why) => SourceErrorCause::bad(format!("{what} {why}"), "save it again with numpy"),
        ArrayError::TooLarge {
            needed_bytes,
            limit_bytes,
        } => SourceErrorCause::TooLarge {
            what: what.to_owned(),
            needed_bytes,
            limit_bytes,
        },
    }
}
