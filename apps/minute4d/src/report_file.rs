//! Files that a command writes among the user's: replaced only if an earlier call wrote them.

use m4_io::atomic;
use m4_io::results::{Kind, ResultFolder};
use minute4d::Error;
use std::path::Path;

/// Writes a file, whole or not at all.
///
/// # Errors
///
/// A file of that name exists and is not a result of an earlier call; or it cannot be written.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    let mut results = ResultFolder::open(folder, Kind::Report)?;
    results.claim([&*name])?;
    atomic::write(path, bytes).map_err(Error::write(path))
}
