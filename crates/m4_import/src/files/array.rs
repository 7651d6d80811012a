//! A `.npy` file.

use crate::core::SourceFault;
use m4_io::npy::{Array, ArrayFault};
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
    pub(crate) fn read(path: &Path, limit_bytes: u64) -> Result<Self, SourceFault> {
        let file = File::open(path)?;
        let file_bytes = file.metadata()?.len();
        // in memory each number takes 8 bytes, in the file 1 at least
        let mut array =
            Array::open(BufReader::new(file), file_bytes, limit_bytes / 8).map_err(|e| array_fault("the array", e))?;
        let whole_numbers = !is_float(&array);
        let n = array.shape.iter().product();
        let values = array.next_f64(n).map_err(|e| array_fault("the array", e))?;
        array.end().map_err(|e| array_fault("the array", e))?;
        Ok(Self {
            shape: array.shape,
            values,
            whole_numbers,
        })
    }
}

/// Whether its numbers are floats.
pub(crate) fn is_float(array: &Array<'_>) -> bool {
    use m4_io::npy::Number;
    matches!(array.number, Number::F16 | Number::F32 | Number::F64)
}

/// Why `what` cannot be read.
pub(crate) fn array_fault(what: &str, fault: ArrayFault) -> SourceFault {
    match fault {
        ArrayFault::Bad(why) => SourceFault::bad(format!("{what} {why}"), "save it again with numpy"),
        ArrayFault::TooLarge {
            needed_bytes,
            limit_bytes,
        } => SourceFault::TooLarge {
            what: what.to_owned(),
            needed_bytes,
            limit_bytes,
        },
    }
}
