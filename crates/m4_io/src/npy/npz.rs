//! Archives of arrays.

use super::Array;
use crate::Fault;
use std::fs::File;
use std::io::BufReader;
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
    /// [`Fault`]: what the system says, or why it is no archive.
    pub fn open(path: &Path) -> Result<Self, Fault> {
        let file = File::open(path)?;
        let file_bytes = file.metadata()?.len();
        let zip = ZipArchive::new(BufReader::new(file)).map_err(|reason| {
            let what = format!("it is not an npz archive of arrays, or a damaged one ({reason})");
            Fault::bad(what, "give the npz file that the tool wrote, whole")
        })?;
        Ok(Self { zip, file_bytes })
    }

    /// Whether it has an array of that name.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        self.zip.index_for_name(&format!("{name}.npy")).is_some()
    }

    /// The first of `keys` that it has.
    pub(crate) fn first_of<'k>(&self, keys: &[&'k str]) -> Option<&'k str> {
        keys.iter().copied().find(|key| self.has(key))
    }

    /// Names of its first arrays, for messages.
    pub fn names(&self) -> String {
        let names = self.zip.file_names().flatten().take(12);
        let names: Vec<String> = names.map(|n| n.trim_end_matches(".npy").to_owned()).collect();
        if names.is_empty() {
            return "nothing".into();
        }
        names.join(", ")
    }

    /// One array, its header read; `None` if it is missing.
    ///
    /// # Errors
    ///
    /// [`Fault`].
    pub fn array(&mut self, name: &str, limit_bytes: u64) -> Result<Option<Array<'_>>, Fault> {
        let called = format!("the array `{name}`");
        let member = match self.zip.by_name(&format!("{name}.npy")) {
            Ok(member) => member,
            Err(ZipError::FileNotFound) => return Ok(None),
            Err(e) => {
                return Err(Fault::bad(format!("{called} cannot be unpacked ({e})"), "save it again"));
            }
        };
        let packed = member.compressed_size().min(self.file_bytes);
        let most_bytes = match member.compression() {
            CompressionMethod::Stored => packed,
            _ => packed.saturating_mul(MAX_RATIO),
        };
        let most_bytes = most_bytes.min(member.size());
        Array::open(&called, member, most_bytes, limit_bytes).map(Some)
    }

    /// One array, which must be there.
    pub(crate) fn need(&mut self, name: &str, limit_bytes: u64) -> Result<Array<'_>, Fault> {
        if !self.has(name) {
            let what = format!("the array `{name}`");
            return Err(Fault::missing(what, format!("it has {}; save it again", self.names())));
        }
        let array = self.array(name, limit_bytes)?;
        array.ok_or_else(|| Fault::missing(name, "save it again"))
    }
}
