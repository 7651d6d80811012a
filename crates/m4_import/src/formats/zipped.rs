//! Files in a zip archive, read from several threads.

use crate::core::{ReadSourceError, SourceFault};
use std::collections::HashSet;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use zip::ZipArchive;

/// What a byte of deflate can unpack to at most.
const MAX_RATIO: u64 = 1032;

/// An archive: its directory, read once; members open the file again.
#[derive(Debug)]
pub(super) struct Zipped {
    path: PathBuf,
    names: HashSet<String>,
    file_bytes: u64,
}

impl Zipped {
    pub fn open(path: &Path) -> Result<Self, ReadSourceError> {
        let io = |e: std::io::Error| SourceFault::Io(e).at(path);
        let file = File::open(path).map_err(io)?;
        let file_bytes = file.metadata().map_err(io)?.len();
        let archive = archive(file).map_err(|fault| fault.at(path))?;
        Ok(Self {
            path: path.to_path_buf(),
            names: archive.file_names().flatten().map(|name| name.into_owned()).collect(),
            file_bytes,
        })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn has(&self, name: &str) -> bool {
        self.names.contains(name)
    }

    /// A member, unpacked.
    pub fn bytes(&self, name: &str) -> Result<Vec<u8>, SourceFault> {
        let mut archive = archive(File::open(&self.path)?)?;
        let damaged =
            |e: String| SourceFault::bad(format!("its member {name} cannot be unpacked ({e})"), "copy it again");
        let member = archive.by_name(name).map_err(|e| damaged(e.to_string()))?;
        let most = member.compressed_size().min(self.file_bytes).saturating_mul(MAX_RATIO);
        let mut bytes = Vec::new();
        // a byte more, so that the checksum is compared
        member
            .take(most.saturating_add(1))
            .read_to_end(&mut bytes)
            .map_err(|e| damaged(e.to_string()))?;
        Ok(bytes)
    }
}

fn archive(file: File) -> Result<ZipArchive<BufReader<File>>, SourceFault> {
    ZipArchive::new(BufReader::new(file))
        .map_err(|e| SourceFault::bad(format!("it is no zip archive ({e})"), "copy it again"))
}
