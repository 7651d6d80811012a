//! Files of the repository that readers are given, and what mutated bytes are wrapped in: valid
//! checksums and compression, so that mutations get past them.

use m4_testkit::repository;
use std::fs;
use std::io::{self, Cursor, Read as _, Write as _};
use std::path::{Path, PathBuf};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// Files of earlier findings: `CORPUS/READER/NAME`, below the root of the repository.
pub const CORPUS: &str = "apps/minute4d/tests/fuzz/corpus";

pub fn fixture(name: &str) -> PathBuf {
    repository().join("fixtures").join(name)
}

pub fn fixture_bytes(name: &str) -> Vec<u8> {
    let path = fixture(name);
    fs::read(&path).unwrap_or_else(|e| panic!("cannot read {}: {e}", path.display()))
}

pub fn copy(from: &Path, to: &Path) -> io::Result<()> {
    if from.is_file() {
        if let Some(folder) = to.parent() {
            fs::create_dir_all(folder)?;
        }
        return fs::copy(from, to).map(|_| ());
    }
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        copy(&entry.path(), &to.join(entry.file_name()))?;
    }
    Ok(())
}

/// Names and contents of the earlier findings in a reader, in the order of the names; empty if
/// there are none.
pub fn corpus(reader: &str) -> io::Result<Vec<(String, Vec<u8>)>> {
    let entries = match fs::read_dir(repository().join(CORPUS).join(reader)) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let mut paths = entries
        .map(|e| e.map(|e| e.path()))
        .collect::<io::Result<Vec<_>>>()?;
    paths.sort();
    let named = |p: PathBuf| {
        let name = p
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        Ok((name, fs::read(&p)?))
    };
    paths.into_iter().map(named).collect()
}

/// What is done to bytes on their way to a file.
pub enum Wrap {
    /// Nothing.
    Plain,
    /// Chunks of a PNG file get checksums that fit; other bytes stay as they are.
    Png,
    /// They are one member of an archive, stored; the others are these.
    Member(String, Vec<(String, Vec<u8>)>),
}

impl Wrap {
    /// In place of the member `name` of the archive `fixtures/ARCHIVE`.
    pub fn member(archive: &str, name: &str) -> Self {
        let mut others = members(archive);
        others.retain(|(other, _)| other != name);
        Self::Member(name.to_owned(), others)
    }

    pub fn on(&self, bytes: &[u8]) -> Vec<u8> {
        match self {
            Self::Plain => bytes.to_vec(),
            Self::Png => png(bytes),
            Self::Member(name, others) => {
                let mut to = ZipWriter::new(Cursor::new(Vec::new()));
                let stored =
                    SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
                let all = others.iter().map(|(name, bytes)| (name, bytes.as_slice()));
                for (name, bytes) in all.chain([(name, bytes)]) {
                    let written = to.start_file(name, stored).map_err(io::Error::from);
                    written
                        .and_then(|()| to.write_all(bytes))
                        .unwrap_or_else(|e| panic!("an archive in memory: {e}"));
                }
                let done = to
                    .finish()
                    .unwrap_or_else(|e| panic!("an archive in memory: {e}"));
                done.into_inner()
            }
        }
    }
}

/// Names and contents of the members of `fixtures/ARCHIVE`.
pub fn members(archive: &str) -> Vec<(String, Vec<u8>)> {
    let broken = |e: &dyn std::fmt::Display| -> ! { panic!("fixtures/{archive} is broken: {e}") };
    let mut zip =
        ZipArchive::new(Cursor::new(fixture_bytes(archive))).unwrap_or_else(|e| broken(&e));
    let mut all = Vec::new();
    for i in 0..zip.len() {
        let mut member = zip.by_index(i).unwrap_or_else(|e| broken(&e));
        let name = member.name().unwrap_or_else(|e| broken(&e)).into_owned();
        let mut bytes = Vec::new();
        member
            .read_to_end(&mut bytes)
            .unwrap_or_else(|e| broken(&e));
        all.push((name, bytes));
    }
    all
}

/// A PNG file whose chunks have the right checksums, as far as its chunks can be followed.
fn png(bytes: &[u8]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    if !bytes.starts_with(b"\x89PNG") {
        return out;
    }
    let mut at = 8;
    while let Some(&[a, b, c, d]) = out.get(at..).and_then(|rest| rest.first_chunk::<4>()) {
        let body = u32::from_be_bytes([a, b, c, d]) as usize;
        let Some(end) = at.checked_add(8).and_then(|n| n.checked_add(body)) else {
            break;
        };
        if out.len() < end.saturating_add(4) {
            break;
        }
        let sum = crc(&out[at + 4..end]);
        out[end..end + 4].copy_from_slice(&sum.to_be_bytes());
        at = end + 4;
    }
    out
}

fn crc(bytes: &[u8]) -> u32 {
    let mut sum = flate2::Crc::new();
    sum.update(bytes);
    sum.sum()
}

#[cfg(test)]
mod tests {
    use super::{Wrap, fixture_bytes, png};

    #[test]
    fn png_checksums_are_recomputed() {
        let whole = fixture_bytes("import/side/masks_png/frame8.png");
        assert_eq!(png(&whole), whole);
        let mut broken = whole.clone();
        broken[30] ^= 1;
        assert_eq!(png(&broken), whole);
        assert_eq!(Wrap::Plain.on(&broken), broken);
    }
}
