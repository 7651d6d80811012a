//! Files that get their final name only after they were read back.

use crate::atomic::AtomicFile;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

/// An [`AtomicFile`] that keeps a hash of what was written.
pub(crate) struct VerifiedFile {
    file: AtomicFile,
    hash: blake3::Hasher,
    bytes: u64,
}

impl VerifiedFile {
    pub fn create(path: &Path) -> io::Result<Self> {
        Ok(Self {
            file: AtomicFile::create(path)?,
            hash: blake3::Hasher::new(),
            bytes: 0,
        })
    }

    /// Puts everything on the disk and compares it with what was written; the path where it lies
    /// until [`VerifiedFile::commit`], for a reader that looks closer.
    pub fn verify(&mut self) -> io::Result<&Path> {
        self.file.sync()?;
        let mut read = blake3::Hasher::new();
        let mut from = File::open(self.file.temporary_path())?;
        let mut block = vec![0; 1 << 16];
        loop {
            match from.read(&mut block)? {
                0 => break,
                n => read.update(&block[..n]),
            };
        }
        if read.finalize() != self.hash.finalize() {
            return Err(io::Error::other(
                "the bytes on the disk are not those that were written",
            ));
        }
        Ok(self.file.temporary_path())
    }

    /// Publishes the file; its size, bytes.
    pub fn commit(self) -> io::Result<u64> {
        self.file.commit()?;
        Ok(self.bytes)
    }
}

impl Write for VerifiedFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = self.file.write(bytes)?;
        self.hash.update(&bytes[..n]);
        self.bytes += n as u64;
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::VerifiedFile;
    use std::io::Write;

    #[test]
    fn a_file_that_changed_on_the_disk_is_not_published() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.bin");
        let mut file = VerifiedFile::create(&path).unwrap();
        file.write_all(b"abc").unwrap();
        let temporary = file.verify().unwrap().to_path_buf();
        std::fs::write(&temporary, b"abd").unwrap();
        assert!(file.verify().is_err());
        std::fs::write(&temporary, b"abc").unwrap();
        file.verify().unwrap();
        assert_eq!(file.commit().unwrap(), 3);
        assert_eq!(std::fs::read(&path).unwrap(), b"abc");
    }
}
