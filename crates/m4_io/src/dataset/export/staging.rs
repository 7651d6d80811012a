//! Folders that are moved to their final location when complete.

use crate::scene::WriteFileError;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// A folder beside the one that is to be made; dropped, it is removed.
pub(in crate::dataset) struct Staging {
    folder: tempfile::TempDir,
    out: PathBuf,
}

impl Staging {
    pub fn new(out: &Path) -> Result<Self, WriteFileError> {
        let parent = out
            .parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        fs::create_dir_all(parent).map_err(|e| WriteFileError::io(parent, e))?;
        let folder = tempfile::Builder::new()
            .prefix(".minute4d-")
            .tempdir_in(parent)
            .map_err(|e| WriteFileError::io(parent, e))?;
        Ok(Self {
            folder,
            out: out.to_path_buf(),
        })
    }

    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Gives what was written its place, what is called `list` last; an older `list` goes first, so that a folder that was left half-way is
    /// none. Files of other names stay. The size of all files, bytes.
    pub fn commit(self, list: &str) -> Result<u64, WriteFileError> {
        let bytes = size(self.folder.path())?;
        remove(&self.out.join(list))?;
        fs::create_dir_all(&self.out).map_err(|e| WriteFileError::io(&self.out, e))?;
        let failed = |e| WriteFileError::io(&self.out, e);
        let mut names = Vec::new();
        for entry in fs::read_dir(self.folder.path()).map_err(failed)? {
            names.push(entry.map_err(failed)?.file_name());
        }
        names.sort_by_key(|name| name.as_os_str() == list);
        for name in names {
            let to = self.out.join(&name);
            remove(&to)?;
            fs::rename(self.folder.path().join(&name), &to).map_err(|e| WriteFileError::io(&to, e))?;
        }
        Ok(bytes)
    }
}

fn remove(path: &Path) -> Result<(), WriteFileError> {
    let done = if path.is_dir() {
        fs::remove_dir_all(path)
    } else {
        fs::remove_file(path)
    };
    match done {
        Err(e) if e.kind() != ErrorKind::NotFound => Err(WriteFileError::io(path, e)),
        _ => Ok(()),
    }
}

fn size(folder: &Path) -> Result<u64, WriteFileError> {
    let failed = |e| WriteFileError::io(folder, e);
    let mut bytes = 0;
    for entry in fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let meta = entry.metadata().map_err(failed)?;
        bytes += if meta.is_dir() {
            size(&entry.path())?
        } else {
            meta.len()
        };
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::Staging;
    use std::fs;

    #[test]
    fn staging_replaces_files_only_on_commit() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("out");
        fs::create_dir_all(out.join("a")).unwrap();
        fs::write(out.join("a/old"), "old").unwrap();
        fs::write(out.join("mine"), "kept").unwrap();
        let dropped = Staging::new(&out).unwrap();
        fs::write(dropped.path().join("list"), "x").unwrap();
        drop(dropped);
        assert!(!out.join("list").exists() && out.join("a/old").exists());

        let staging = Staging::new(&out).unwrap();
        fs::create_dir(staging.path().join("a")).unwrap();
        fs::write(staging.path().join("a/new"), "new").unwrap();
        fs::write(staging.path().join("list"), "l").unwrap();
        assert_eq!(staging.commit("list").unwrap(), 4);
        assert!(!out.join("a/old").exists() && out.join("mine").exists());
        assert_eq!(fs::read(out.join("a/new")).unwrap(), b"new");
        // nothing is left beside it
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
