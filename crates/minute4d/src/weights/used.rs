//! What a record says of the weights that a result was made with.

use super::check;
use super::{Entry, State, Store, WeightsError};
use serde::{Deserialize, Serialize};
use std::fs::{self, File};
use std::io;

/// Weights that a result was made with: which, and what their licence asks of the result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Used {
    /// The entry's name.
    pub name: String,
    /// The file's name.
    pub file: String,
    /// Its size.
    pub bytes: u64,
    /// Its SHA-256, hexadecimal.
    pub sha256: String,
    /// The licence of the weights.
    pub licence: String,
    /// False where that forbids commercial use.
    pub commercial: bool,
    /// Where the file came from.
    pub source: String,
}

impl Store {
    /// What a record is to say of `entry`, which was used. A file that this store took is not read again unless its size
    /// is another than recorded; one of another tool is.
    ///
    /// # Errors
    ///
    /// [`WeightsError::Absent`] if it is not here, [`WeightsError::Read`] if it cannot be read.
    pub fn used(&self, entry: &Entry) -> Result<Used, WeightsError> {
        let path = self.require(entry)?;
        let failed = |source| WeightsError::Read {
            path: path.clone(),
            source,
        };
        let bytes = fs::metadata(&path).map_err(failed)?.len();
        let stored = matches!(self.state(entry), State::Stored(_));
        let record = self.record(entry).filter(|r| stored && r.bytes == bytes);
        let (sha256, source) = match record {
            Some(record) => (record.sha256, record.source),
            None => {
                let file = File::open(&path).map_err(failed)?;
                let sum = check::copy(file, io::sink(), None).map_err(|(_, error)| failed(error))?;
                (sum.sha256, entry.origin.words())
            }
        };
        Ok(Used {
            name: entry.name.to_owned(),
            file: entry.file.to_owned(),
            bytes,
            sha256,
            licence: entry.licence.to_owned(),
            commercial: entry.commercial,
            source,
        })
    }
}
