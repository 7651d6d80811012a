//! Plans a manifest from the files that a user names.

mod find;

use find::inputs;

use crate::batch::error::BatchError;
use crate::batch::layout::Layout;
use crate::batch::manifest::{Arguments, Job, Manifest};
use crate::batch::names;
use crate::batch::publish::{Present, present};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// The inputs of a plan.
pub struct Plan<'a> {
    /// Files, folders, lists (`@FILE`).
    pub given: &'a [String],
    /// Look into folders of folders.
    pub recursive: bool,
    /// The folder of results.
    pub results: &'a Path,
    /// What every run is started with.
    pub run: Arguments,
    /// BLAKE3 of a file or a folder, as runs compute it.
    pub hash: &'a dyn Fn(&Path) -> Result<String, String>,
}

/// Lists the clips with their sizes and hashes, in the order of their ids, and makes the folder of results.
///
/// # Errors
///
/// [`BatchError`].
pub fn plan(plan: &Plan<'_>) -> Result<Manifest, BatchError> {
    let paths = inputs(plan.given, plan.recursive)?;
    let mut named = Vec::with_capacity(paths.len());
    for path in &paths {
        named.push((name(path), text(path)?));
    }
    let ids = names::ids(&named);
    let layout = Layout::new(plan.results);
    for id in &ids {
        let result = layout.result(id);
        if present(&result, "")? == Present::NotOurs {
            return Err(BatchError::NotOurs { path: result });
        }
    }
    let mut jobs = Vec::with_capacity(named.len());
    for (((_, input), id), path) in named.into_iter().zip(ids).zip(paths) {
        let blake3 = (plan.hash)(&path).map_err(|reason| BatchError::read(&path)(io::Error::other(reason)))?;
        jobs.push(Job {
            output: text(&layout.result(&id))?,
            id,
            input,
            bytes: size(&path)?,
            blake3,
        });
    }
    jobs.sort_by(|a, b| a.id.cmp(&b.id));
    let states = layout.states();
    fs::create_dir_all(&states).map_err(BatchError::write(&states))?;
    Ok(Manifest {
        results: text(plan.results)?,
        run: plan.run.clone(),
        jobs,
    })
}

fn text(path: &Path) -> Result<String, BatchError> {
    path.to_str().map(str::to_owned).ok_or_else(|| BatchError::Input {
        given: path.display().to_string(),
        reason: "is not UTF-8, which a manifest cannot hold; rename it",
    })
}

/// The name of a clip: that of its file without the extension, or of its folder.
fn name(path: &Path) -> String {
    let name = if path.is_dir() {
        path.file_name()
    } else {
        path.file_stem()
    };
    name.map_or_else(String::new, |n| n.to_string_lossy().into_owned())
}

/// Bytes of a file, or of everything in a folder that is not hidden.
fn size(path: &Path) -> Result<u64, BatchError> {
    let failed = |source| BatchError::read(path)(source);
    let found = fs::metadata(path).map_err(failed)?;
    if !found.is_dir() {
        return Ok(found.len());
    }
    let mut sum = 0;
    for entry in fs::read_dir(path).map_err(failed)? {
        let entry: PathBuf = entry.map_err(failed)?.path();
        let hidden = entry.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
        if !hidden {
            sum += size(&entry)?;
        }
    }
    Ok(sum)
}
