//! Reads files as bytes, and writes files that are read back before they are published.

use crate::scene::verified::VerifiedFile;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

/// The bytes of a regular file: devices and pipes, which may never end, are refused.
pub(crate) fn load(path: &Path) -> io::Result<Vec<u8>> {
    let file = File::open(path)?;
    let facts = file.metadata()?;
    if !facts.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "it is not a regular file"));
    }
    let mut bytes = Vec::new();
    file.take(facts.len()).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Writes `bytes` to `path`, atomically, and reads them back first.
pub(crate) fn publish(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = VerifiedFile::create(path)?;
    file.write_all(bytes)?;
    file.verify()?;
    file.commit()?;
    Ok(())
}
