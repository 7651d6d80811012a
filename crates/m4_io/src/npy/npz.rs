//! Archives of arrays.

use super::{Array, ArrayError};
use std::fs::File;
use std::io::{self, BufReader};
use std::path::Path;
use zip::result::ZipError;
use zip::{CompressionMethod, ZipArchive};

/// What a byte of deflate can unpack to at most.
const MAX_RATIO: u64 = 1032;

/// An archive of arrays.
pub struct Npz {
    zip: ZipArchive<BufReader<File>>,
    file_bytes: u64,
}

impl Npz {
    /// Opens the file and reads its directory.
    ///
    /// # Errors
    ///
    /// What the system says, or in its place ([`Err`] within [`Ok`]) why it is no archive.
    pub fn open(path: &Path) -> io::Result<Result<Self, String>> {
        let file = File::open(path)?;
        let file_bytes = file.metadata()?.len();
        Ok(match ZipArchive::new(BufReader::new(file)) {
            Ok(zip) => Ok(Self { zip, file_bytes }),
            Err(e) => Err(e.to_string()),
        })
    }

    /// Whether it has an array of that name.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        self.zip.index_for_name(&format!("{name}.npy")).is_some()
    }

    /// Names of its first arrays, for messages.
    pub fn names(&self) -> String {
        let names: Vec<String> = self
            .zip
            .file_names()
            .flatten()
            .take(12)
            .map(|n| n.into_owned())
            .collect();
        if names.is_empty() {
            return "nothing".into();
        }
        let names: Vec<&str> = names.iter().map(|n| n.strip_suffix(".npy").unwrap_or(n)).collect();
        names.join(", ")
    }

    /// One array, its header read; `None` if it is missing.
    ///
    /// # Errors
    ///
    /// [`ArrayError`].
    pub fn array(&mut self, name: &str, limit_bytes: u64) -> Result<Option<Array<'_>>, ArrayError> {
        let member = match self.zip.by_name(&format!("{name}.npy")) {
            Ok(member) => member,
            Err(ZipError::FileNotFound) => return Ok(None),
            Err(e) => return Err(ArrayError::Bad(format!("cannot be unpacked ({e})"))),
        };
        let packed = member.compressed_size().min(self.file_bytes);
        let most_bytes = match member.compression() {
            CompressionMethod::Stored => packed,
            _ => packed.saturating_mul(MAX_RATIO),
        };
        let most_bytes = most_bytes.min(member.size());
        Array::open(member, most_bytes, limit_bytes).map(Some)
    }
}
