//! A [`Capture`] to files of MegaSaM, whole or not at all.

use super::output::Output;
use super::{Layout, WriteMegasamError, motion};
use crate::atomic::AtomicFile;
use crate::npy::{self, Pieces};
use m4_scene::{Capture, Progress};
use std::cell::Cell;
use std::fs::{self, File};
use std::io::{self, BufReader};
use std::path::Path;
use zip::ZipArchive;

/// What was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// Size of all files.
    pub bytes: u64,
    /// What the files do not hold.
    pub dropped: Vec<String>,
    /// What they hold with fewer digits.
    pub rounded: Vec<String>,
}

/// Writes `capture` to `path`: a file of the npz layouts, else a folder. Every file is written under another name, read
/// back and compared bit by bit; only when all are right do they get their names.
///
/// # Errors
///
/// [`WriteMegasamError`]: the layout cannot hold the capture, the file system refuses, or the caller asked to stop.
pub fn write(
    path: &Path,
    capture: &Capture,
    layout: Layout,
    progress: &dyn Progress,
) -> Result<Written, WriteMegasamError> {
    let output = Output::new(capture, layout).map_err(|what| WriteMegasamError::Capture {
        path: path.to_path_buf(),
        what,
    })?;
    let arrays = output.arrays();
    let total: usize = arrays.iter().map(|a| a.count).sum();
    let done = Cell::new(0);
    let go_on = || {
        done.set(done.get() + 1);
        progress.update("write frames", done.get(), total, "");
        !progress.cancelled()
    };
    let files = if layout == Layout::Reconstruction {
        folder(path, &arrays, &go_on)?
    } else {
        vec![archive(path, &arrays, &go_on)?]
    };
    let mut bytes = 0;
    for file in &files {
        let written = fs::metadata(file.temporary_path()).map_err(|e| failed(path, e))?;
        bytes += written.len();
    }
    for file in files {
        file.commit().map_err(|e| failed(path, e))?;
    }
    if layout == Layout::Reconstruction && arrays.iter().all(|a| a.name != "motion_prob") {
        // of an earlier capture: it would be taken for the map of this one
        match fs::remove_file(path.join(motion::FILE)) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(failed(path, e)),
            _ => {}
        }
    }
    let (dropped, rounded) = output.losses();
    Ok(Written {
        bytes,
        dropped,
        rounded,
    })
}

fn failed(path: &Path, source: io::Error) -> WriteMegasamError {
    let path = path.to_path_buf();
    match source.kind() {
        io::ErrorKind::Interrupted => WriteMegasamError::Cancelled { path },
        _ => WriteMegasamError::Io { path, source },
    }
}

fn differs(path: &Path, name: &str, what: &str) -> WriteMegasamError {
    WriteMegasamError::ReadBack {
        path: path.to_path_buf(),
        what: format!("the array `{name}` {what}"),
    }
}

fn archive(path: &Path, arrays: &[Pieces<'_>], go_on: &dyn Fn() -> bool) -> Result<AtomicFile, WriteMegasamError> {
    let mut file = AtomicFile::create(path).map_err(|e| failed(path, e))?;
    npy::write_npz(&mut file, arrays, go_on).map_err(|e| failed(path, e))?;
    file.sync().map_err(|e| failed(path, e))?;
    let written = File::open(file.temporary_path()).map_err(|e| failed(path, e))?;
    let back = |what: String| WriteMegasamError::ReadBack {
        path: path.to_path_buf(),
        what,
    };
    let mut zip = ZipArchive::new(BufReader::new(written)).map_err(|e| back(e.to_string()))?;
    for array in arrays {
        let member = zip
            .by_name(&format!("{}.npy", array.name))
            .map_err(|e| back(e.to_string()))?;
        npy::same(member, array).map_err(|what| differs(path, array.name, &what))?;
    }
    Ok(file)
}

fn folder(path: &Path, arrays: &[Pieces<'_>], go_on: &dyn Fn() -> bool) -> Result<Vec<AtomicFile>, WriteMegasamError> {
    let mut files = Vec::new();
    for array in arrays {
        let at = path.join(format!("{}.npy", array.name));
        let mut file = AtomicFile::create(&at).map_err(|e| failed(&at, e))?;
        npy::write_npy(&mut file, array, go_on).map_err(|e| failed(&at, e))?;
        file.sync().map_err(|e| failed(&at, e))?;
        let written = File::open(file.temporary_path()).map_err(|e| failed(&at, e))?;
        npy::same(BufReader::new(written), array).map_err(|what| differs(&at, array.name, &what))?;
        files.push(file);
    }
    Ok(files)
}
