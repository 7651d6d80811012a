//! The files of a source: which of them may be read, and what several formats share.
//!
//! ```text
//! Members    members of a zip archive, or of the folder that it was unpacked to
//! images     a folder or a video as images of known size, and lenses that fit them
//! clock      frames per second, times in frames
//! ```

pub(crate) mod clock;
pub(crate) mod images;

use crate::dataset::ImportOptions;
use crate::error::AtPath;
use crate::reach::Bounds;
use crate::{Fault, ReadError};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use zip::ZipArchive;
use zip::result::ZipError;

/// The bounds of a source: only files in its folder, and in those that the options name, are read.
#[derive(Debug, Clone)]
pub(crate) struct Inside(Bounds);

impl Inside {
    /// Of the source in `folder` whose images may lie where the options say.
    pub(crate) fn of(folder: &Path, options: &ImportOptions) -> Self {
        Self(Bounds::new(options.reach, folder, options.images.as_deref()))
    }

    /// Of what the user named beside the source: files in the folder `named`, or that file.
    pub(crate) fn named(named: &Path, options: &ImportOptions) -> Self {
        Self(Bounds::new(options.reach, named, []))
    }

    /// The file, if it may be read or is missing.
    pub(crate) fn check<P: AsRef<Path>>(&self, file: P) -> Result<P, Fault> {
        self.0.check(file.as_ref())?;
        Ok(file)
    }

    /// The same; the error names the file.
    pub(crate) fn file(&self, file: PathBuf) -> Result<PathBuf, ReadError> {
        self.0.check(&file).at(&file)?;
        Ok(file)
    }

    /// Checks many files.
    pub(crate) fn files(&self, files: Vec<PathBuf>) -> Result<Vec<PathBuf>, ReadError> {
        files.into_iter().map(|file| self.file(file)).collect()
    }
}

/// An archive, or the folder that it was unpacked to. Reading takes one member at a time from an archive.
#[derive(Debug)]
pub(crate) enum Members {
    Folder { root: PathBuf, inside: Inside },
    Zip(Mutex<ZipArchive<BufReader<File>>>),
}

impl Members {
    /// Opens it; the directory of an archive is read here. Of a folder files are read that are `inside`.
    pub(crate) fn open(path: &Path, inside: Inside) -> Result<Self, Fault> {
        if path.is_dir() {
            let root = path.to_path_buf();
            return Ok(Self::Folder { root, inside });
        }
        let archive = ZipArchive::new(BufReader::new(File::open(path)?));
        let archive = archive.map_err(|e| {
            let what = format!("it is not a zip archive, or a damaged one ({e})");
            Fault::bad(what, "copy it again")
        })?;
        Ok(Self::Zip(Mutex::new(archive)))
    }

    /// Names of the files in `folder` (one level), without it.
    pub(crate) fn names(&self, folder: &str) -> Result<Vec<String>, Fault> {
        match self {
            Self::Folder { root, .. } => {
                let inner = root.join(folder);
                if !inner.is_dir() {
                    return Ok(Vec::new());
                }
                let names = std::fs::read_dir(inner)?.map(|e| Ok(e?.file_name().to_string_lossy().into_owned()));
                names.collect()
            }
            Self::Zip(archive) => {
                let archive = archive.lock().map_err(|_| poisoned())?;
                let start = format!("{folder}/");
                let inside = archive.file_names().flatten().filter_map(|n| {
                    let name = n.strip_prefix(start.as_str())?;
                    (!name.is_empty() && !name.contains('/')).then(|| name.to_owned())
                });
                Ok(inside.collect())
            }
        }
    }

    /// Whether there is a file of that name.
    pub(crate) fn has(&self, name: &str) -> Result<bool, Fault> {
        match self {
            Self::Folder { root, .. } => Ok(root.join(name).is_file()),
            Self::Zip(archive) => Ok(archive.lock().map_err(|_| poisoned())?.index_for_name(name).is_some()),
        }
    }

    /// All bytes of one, `limit_bytes` at most; `None` if it is missing.
    pub(crate) fn read(&self, name: &str, limit_bytes: u64) -> Result<Option<Vec<u8>>, Fault> {
        let too_large = |needed_bytes| Fault::too_large(name, needed_bytes, limit_bytes);
        let mut out = Vec::new();
        match self {
            Self::Folder { root, inside } => {
                let path = inside.check(root.join(name))?;
                if !path.is_file() {
                    return Ok(None);
                }
                File::open(path)?.take(limit_bytes + 1).read_to_end(&mut out)?;
            }
            Self::Zip(archive) => {
                let mut archive = archive.lock().map_err(|_| poisoned())?;
                let unpacked =
                    |e: String| Fault::bad(format!("{name} cannot be unpacked ({e})"), "copy the archive again");
                let mut member = match archive.by_name(name) {
                    Ok(member) => member,
                    Err(ZipError::FileNotFound) => return Ok(None),
                    Err(e) => return Err(unpacked(e.to_string())),
                };
                if member.size() > limit_bytes {
                    return Err(too_large(member.size()));
                }
                (&mut member).take(limit_bytes + 1).read_to_end(&mut out).map_err(|e| unpacked(e.to_string()))?;
            }
        }
        if out.len() as u64 > limit_bytes {
            return Err(too_large(out.len() as u64));
        }
        Ok(Some(out))
    }
}

fn poisoned() -> Fault {
    Fault::bad("another thread failed while it read the archive", "read it again")
}
