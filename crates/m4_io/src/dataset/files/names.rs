//! Names of files: in order, below a folder, and what they begin with.

use crate::dataset::{ReadSourceError, SourceErrorCause};
use crate::video::natural;
use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

/// The files of a folder whose extension is one of `extensions` (small letters), in natural order: `2.png` before `10.png`.
/// Hidden files are passed over; an empty list is no error.
pub(crate) fn listed(folder: &Path, extensions: &[&str]) -> Result<Vec<PathBuf>, ReadSourceError> {
    let io = |source| SourceErrorCause::Io(source).at(folder);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let file = entry.map_err(io)?.path();
        let hidden = file.file_name().is_none_or(|n| n.to_string_lossy().starts_with('.'));
        let extension = file.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        if !hidden && extension.is_some_and(|e| extensions.contains(&e.as_str())) && file.is_file() {
            files.push(file);
        }
    }
    files.sort_by(|a, b| natural(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(files)
}

/// The name without folders and extension.
pub(crate) fn stem(path: &Path) -> String {
    path.file_stem()
        .map(|s| s.to_string_lossy().into_owned())
        .unwrap_or_default()
}

/// `name`, as a file lists it, below `folder`; names that lead out of it are refused.
pub(crate) fn below(folder: &Path, name: &str) -> Result<PathBuf, SourceErrorCause> {
    let inside = |part: Component<'_>| matches!(part, Component::Normal(_) | Component::CurDir);
    if name.is_empty() || !Path::new(name).components().all(inside) {
        let what = format!("the name {name:?} is not below the folder of the images");
        return Err(SourceErrorCause::bad(what, "write names relative to that folder"));
    }
    Ok(folder.join(name))
}

/// The first `N` bytes of a file; fewer if it is shorter, none if it cannot be read.
pub(crate) fn first_bytes<const N: usize>(path: &Path) -> Vec<u8> {
    let mut start = Vec::new();
    if let Ok(file) = File::open(path) {
        // what cannot be read is of no format
        let _ = file.take(N as u64).read_to_end(&mut start);
    }
    start
}
