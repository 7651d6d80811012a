//! Writes files atomically.
//!
//! The bytes go to `.NAME.tmp-PID` in the same folder, reach the disk (`fsync`) and only then take
//! the place of `NAME`: a reader of `NAME` sees the old file or the new one, never half of it.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// A file that has its own name only from [`AtomicFile::commit`] on; dropped before that, it leaves
/// nothing behind.
#[derive(Debug)]
pub struct AtomicFile {
    target: PathBuf,
    temporary: PathBuf,
    /// `None` once committed or abandoned.
    writer: Option<BufWriter<File>>,
}

impl AtomicFile {
    /// Starts to write `target`; makes its folder if that is missing. A link is followed: the file
    /// that it names is replaced. Errors: the failure of the file system; also those of [`check`].
    pub fn create(target: &Path) -> io::Result<Self> {
        check(target)?;
        let is_link = fs::symlink_metadata(target).is_ok_and(|kind| kind.is_symlink());
        let target = &if is_link {
            target.canonicalize()?
        } else {
            target.to_path_buf()
        };
        let name = target.file_name().ok_or_else(no_file)?;
        let folder = match target.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder.to_path_buf(),
            _ => PathBuf::from("."),
        };
        fs::create_dir_all(&folder)?;
        let mut hidden = OsString::from(".");
        hidden.push(name);
        hidden.push(format!(".tmp-{}", std::process::id()));
        let temporary = folder.join(hidden);
        let file = File::create(&temporary)?;
        Ok(Self {
            target: target.to_path_buf(),
            temporary,
            writer: Some(BufWriter::new(file)),
        })
    }

    /// Where the bytes are until [`AtomicFile::commit`]: for checking them before they are
    /// published.
    #[must_use]
    pub fn temporary_path(&self) -> &Path {
        &self.temporary
    }

    /// Writes out what is buffered, so that [`AtomicFile::temporary_path`] can be read back.
    pub fn sync(&mut self) -> io::Result<()> {
        let writer = self.open()?;
        writer.flush()?;
        writer.get_ref().sync_all()
    }

    /// Publishes the file under its own name, replacing what was there.
    /// Errors: the failure of the file system; `target` is then as it was before.
    pub fn commit(mut self) -> io::Result<()> {
        self.sync()?;
        self.writer = None;
        fs::rename(&self.temporary, &self.target).inspect_err(|_| {
            let _ = fs::remove_file(&self.temporary);
        })?;
        sync_folder(&self.target);
        Ok(())
    }

    fn open(&mut self) -> io::Result<&mut BufWriter<File>> {
        self.writer
            .as_mut()
            .ok_or_else(|| io::Error::other("the file was closed already"))
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.open()?.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.open()?.flush()
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.open()?.seek(to)
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        if let Some(writer) = self.writer.take() {
            // The buffered bytes are not wanted any more.
            drop(writer.into_parts());
            let _ = fs::remove_file(&self.temporary);
        }
    }
}

/// Refuses what cannot be replaced by a file. Errors: `target` names no file (`/`, `..`), is a link
/// to nothing, or is a folder, a device, a socket or a pipe.
pub fn check(target: &Path) -> io::Result<()> {
    target.file_name().ok_or_else(no_file)?;
    let is_link = fs::symlink_metadata(target).is_ok_and(|kind| kind.is_symlink());
    match fs::metadata(target) {
        Ok(kind) if kind.is_file() => Ok(()),
        Ok(kind) if kind.is_dir() => Err(io::Error::new(
            io::ErrorKind::IsADirectory,
            "the path is a folder that exists",
        )),
        Ok(_) => Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            "the path is a device, a socket or a pipe, and no file",
        )),
        Err(error) if is_link => Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            format!("the path is a link that leads nowhere ({error})"),
        )),
        // Missing, or in a folder that cannot be read: the attempt to write says why.
        Err(_) => Ok(()),
    }
}

fn no_file() -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, "the path names no file")
}

/// Removes the files in `folder`, and in the folders in it if `deep`, that killed processes left of
/// files whose names pass `is_ours`, such as [`is_temporary`]; a folder that is missing has none.
///
/// # Errors
///
/// The failure of the file system.
pub fn remove_temporary(
    folder: &Path,
    deep: bool,
    is_ours: &dyn Fn(&str) -> bool,
) -> io::Result<()> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        let entry = entry?;
        let kind = entry.file_type()?;
        if deep && kind.is_dir() {
            remove_temporary(&entry.path(), deep, is_ours)?;
        } else if kind.is_file() && entry.file_name().to_str().is_some_and(is_ours) {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// Whether a file of this name is what a process that was killed left of any file.
#[must_use]
pub fn is_temporary(name: &str) -> bool {
    name.rsplit_once(".tmp-").is_some_and(|(start, _)| {
        start
            .strip_prefix('.')
            .is_some_and(|of| !of.is_empty() && is_temporary_of(name, of))
    })
}

/// Whether a file of this name is what a process that was killed left of one to be called `of`.
#[must_use]
pub fn is_temporary_of(name: &str, of: &str) -> bool {
    let process = name
        .strip_prefix('.')
        .and_then(|name| name.strip_prefix(of)?.strip_prefix(".tmp-"));
    process.is_some_and(|digits| !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit()))
}

/// Makes the rename durable, where the system lets a folder be opened; the file's own bytes are
/// safe by now.
pub(crate) fn sync_folder(target: &Path) {
    let folder = target.parent().filter(|p| !p.as_os_str().is_empty());
    if let Ok(folder) = File::open(folder.unwrap_or(Path::new("."))) {
        let _ = folder.sync_all();
    }
}

/// Writes `bytes` to `path`, atomically. Errors: the failure of the file system; `path` is then as
/// it was before.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = AtomicFile::create(path)?;
    file.write_all(bytes)?;
    file.commit()
}

#[cfg(test)]
mod tests {
    use super::{AtomicFile, write};
    use std::fs;
    use std::io::Write;

    #[test]
    fn files_are_replaced_atomically() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("deep/down/scene.bin");
        write(&path, b"old").unwrap();
        let mut file = AtomicFile::create(&path).unwrap();
        file.write_all(b"new and longer").unwrap();
        file.sync().unwrap();
        let temporary = file
            .temporary_path()
            .file_name()
            .unwrap()
            .to_str()
            .unwrap()
            .to_owned();
        assert!(
            super::is_temporary_of(&temporary, "scene.bin")
                && !super::is_temporary_of(&temporary, "scene")
        );
        assert!(!super::is_temporary_of("scene.bin", "scene.bin"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read(file.temporary_path()).unwrap(), b"new and longer");
        file.commit().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new and longer");
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn a_dropped_file_leaves_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let mut file = AtomicFile::create(&dir.path().join("x")).unwrap();
        file.write_all(&[7; 100_000]).unwrap();
        drop(file);
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    }
}
