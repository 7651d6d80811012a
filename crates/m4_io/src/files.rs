//! Opens regular files, reads whole files within a limit, lists the files of a folder, and works on
//! frames in parallel.

use crate::error::AtPath;
use crate::{Fault, ReadError};
use m4_core::Progress;
use rayon::prelude::*;
use serde::de::DeserializeOwned;
use std::cmp::Ordering;
use std::fs::{self, File, FileType, Metadata};
use std::io::{self, ErrorKind, Read};
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::{self, AtomicUsize};

/// Longest list of frames that is read, bytes: a frame takes some kilobytes, and a hundred thousand
/// frames are no clip.
const MAX_TEXT_BYTES: u64 = 256 << 20;

/// Memory that reading may take beside [`PER_BYTE`], bytes.
pub(crate) const FREE_BYTES: u64 = 64 << 20;
/// Bytes of memory per byte of the file.
const PER_BYTE: u64 = 64;

/// Memory that reading a file may take, bytes; what it takes in the end is limited by those who
/// keep it (`max_memory_bytes`).
pub(crate) fn memory_for(file_bytes: u64) -> u64 {
    file_bytes
        .saturating_mul(PER_BYTE)
        .saturating_add(FREE_BYTES)
}

/// How much of [`FREE_BYTES`] a file takes that needs so much memory.
pub(crate) fn beyond(needed_bytes: u64, file_bytes: u64) -> u64 {
    needed_bytes.saturating_sub(file_bytes.saturating_mul(PER_BYTE))
}

/// Fails where `what` of a file of `file_bytes` would take more memory than [`memory_for`] allows.
pub(crate) fn within_memory(what: &str, needed_bytes: u64, file_bytes: u64) -> Result<(), Fault> {
    let limit_bytes = memory_for(file_bytes);
    if needed_bytes <= limit_bytes {
        return Ok(());
    }
    let (needed, limit) = (needed_bytes >> 20, limit_bytes >> 20);
    let what = format!(
        "{what} in {file_bytes} bytes would take {needed} MiB of memory, above the limit of {limit} MiB (64 MiB and 64 times the file)"
    );
    Err(Fault::unsupported(
        what,
        "check that this is the right file; if it is, make it smaller or store it with less compression",
    ))
}

/// Opens a regular file to read.
///
/// The type is asked for before the file is opened, since opening a pipe waits for its writer, and
/// of the handle again. Every file that a user or another file names is opened here.
///
/// # Errors
///
/// The error of the system; `InvalidData` with the type for a pipe, a socket or a device, which may
/// never end.
pub fn open(path: &Path) -> io::Result<File> {
    check(path)?;
    let file = File::open(path)?;
    regular(&file.metadata()?)?;
    Ok(file)
}

/// Checks that a path leads to a regular file, without opening it.
///
/// # Errors
///
/// As [`open`].
pub fn check(path: &Path) -> io::Result<()> {
    regular(&fs::metadata(path)?)
}

/// Reads a regular file of at most `limit_bytes`.
///
/// # Errors
///
/// As [`open`]; `InvalidData` for a larger file.
pub fn read(path: &Path, limit_bytes: u64) -> io::Result<Vec<u8>> {
    let file = open(path)?;
    let size_bytes = file.metadata()?.len();
    if size_bytes > limit_bytes {
        let (size, limit) = (size_bytes.div_ceil(1 << 20), limit_bytes >> 20);
        return Err(invalid(format!(
            "it has {size} MiB, above the limit of {limit} MiB; check that this is the right file"
        )));
    }
    let mut bytes = Vec::new();
    // A file that grows meanwhile is read to the size that was checked.
    file.take(size_bytes).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Reads a regular file of UTF-8 text of at most `limit_bytes`.
///
/// # Errors
///
/// As [`read`]; `InvalidData` for bytes that are not UTF-8.
pub fn read_text(path: &Path, limit_bytes: u64) -> io::Result<String> {
    let bytes = read(path, limit_bytes)?;
    utf8(&bytes)
        .map(str::to_owned)
        .map_err(|(at, fault)| invalid(format!("byte {at}: {fault}")))
}

/// Refuses what has no end, or none that is known before.
fn regular(facts: &Metadata) -> io::Result<()> {
    if facts.is_file() {
        return Ok(());
    }
    if facts.is_dir() {
        return Err(ErrorKind::IsADirectory.into());
    }
    Err(invalid(format!(
        "it is {}, not a regular file; write its contents to a file and give that",
        kind(facts.file_type())
    )))
}

#[cfg(unix)]
fn kind(kind: FileType) -> &'static str {
    use std::os::unix::fs::FileTypeExt;
    if kind.is_fifo() {
        "a pipe"
    } else if kind.is_socket() {
        "a socket"
    } else {
        "a device"
    }
}

#[cfg(not(unix))]
fn kind(_: FileType) -> &'static str {
    "a pipe or a device"
}

fn invalid(what: String) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, what)
}

/// A text without the byte order mark of UTF-8 that editors on Windows put before it.
#[must_use]
pub fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

/// A text file.
pub(crate) fn text(path: &Path) -> Result<String, ReadError> {
    let bytes = read(path, MAX_TEXT_BYTES).at(path)?;
    utf8(&bytes)
        .map(str::to_owned)
        .map_err(|(at, fault)| fault.within(path, format!("byte {at}")))
}

/// The text in the bytes of a file, or the first byte that is none.
pub(crate) fn utf8(bytes: &[u8]) -> Result<&str, (usize, Fault)> {
    std::str::from_utf8(without_mark(bytes)).map_err(|e| {
        let wide = bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]);
        let what = if wide {
            "it is UTF-16 text, as its byte order mark says"
        } else {
            "it is not text (UTF-8)"
        };
        let hint = if wide {
            "save it as UTF-8"
        } else {
            "give the text file that the tool wrote"
        };
        (e.valid_up_to(), Fault::bad(what, hint))
    })
}

/// A JSON file.
pub(crate) fn json<T: DeserializeOwned>(path: &Path) -> Result<T, ReadError> {
    parse_json(&text(path)?).at(path)
}

/// JSON of a file or of a member of an archive.
pub(crate) fn parse_json<T: DeserializeOwned>(text: &str) -> Result<T, Fault> {
    serde_json::from_str(text).map_err(|e| {
        let line = e.line().checked_sub(1).and_then(|n| text.lines().nth(n));
        let has = |word: &str| line.is_some_and(|line| line.contains(word));
        let hint = if has("NaN") || has("Infinity") {
            "JSON has neither NaN nor Infinity; drop the frames whose pose was not found"
        } else {
            "write the file again with the tool that made it"
        };
        Fault::bad(format!("it is not the JSON that was expected ({e})"), hint)
    })
}

/// The files of a folder whose extension is one of `extensions` (small letters), in natural order:
/// `2.png` before `10.png`. Hidden files are passed over; an empty list is no error.
pub(crate) fn listed(folder: &Path, extensions: &[&str]) -> Result<Vec<PathBuf>, ReadError> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).at(folder)? {
        let file = entry.at(folder)?.path();
        let hidden = file
            .file_name()
            .is_none_or(|n| n.to_string_lossy().starts_with('.'));
        let extension = file
            .extension()
            .map(|e| e.to_string_lossy().to_ascii_lowercase());
        if !hidden && extension.is_some_and(|e| extensions.contains(&e.as_str())) && file.is_file()
        {
            files.push(file);
        }
    }
    files.sort_by(|a, b| natural(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(files)
}

/// The name without folders and extension.
pub(crate) fn stem(path: &Path) -> String {
    path.file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

/// `name`, as a file lists it, below `folder`; names that lead out of it are refused.
pub(crate) fn below(folder: &Path, name: &str) -> Result<PathBuf, Fault> {
    let inside = |part: Component<'_>| matches!(part, Component::Normal(_) | Component::CurDir);
    if name.is_empty() || !Path::new(name).components().all(inside) {
        let what = format!("the name {name:?} is not below the folder of the images");
        return Err(Fault::bad(what, "write names relative to that folder"));
    }
    Ok(folder.join(name))
}

/// The first `N` bytes of a file; fewer if it is shorter, none if it cannot be read.
pub(crate) fn first_bytes<const N: usize>(path: &Path) -> Vec<u8> {
    let mut start = Vec::new();
    if let Ok(file) = open(path) {
        // what cannot be read is of no format
        let _ = file.take(N as u64).read_to_end(&mut start);
    }
    start
}

/// Calls `one` for each of `frames` and its index, in parallel; the results in order, or the first
/// error (`stopped`).
pub(crate) fn in_parallel<T: Sync, U: Send, E: Send>(
    phase: &str,
    frames: &[T],
    progress: &dyn Progress,
    stopped: impl Fn() -> E + Sync,
    one: impl Fn(usize, &T) -> Result<U, E> + Sync,
) -> Result<Vec<U>, E> {
    let done = AtomicUsize::new(0);
    let each = |(i, frame): (usize, &T)| {
        if progress.cancelled() {
            return Err(stopped());
        }
        let out = one(i, frame)?;
        let done = done.fetch_add(1, atomic::Ordering::Relaxed) + 1;
        progress.update(phase, done, frames.len(), "");
        Ok(out)
    };
    let results: Vec<Result<U, E>> = frames.par_iter().enumerate().map(each).collect();
    results.into_iter().collect()
}

/// Compares text in which runs of digits count as numbers: `2.png` before `10.png`.
pub(crate) fn natural(a: &str, b: &str) -> Ordering {
    let (mut a_rest, mut b_rest) = (a, b);
    loop {
        let (a_text, a_digits, a_next) = split(a_rest);
        let (b_text, b_digits, b_next) = split(b_rest);
        // Numbers of any length: without leading zeros, the longer is the larger.
        let number = |d: &str| {
            let d = d.trim_start_matches('0').to_owned();
            (d.len(), d)
        };
        let order = a_text
            .cmp(b_text)
            .then_with(|| number(a_digits).cmp(&number(b_digits)));
        if order != Ordering::Equal {
            return order;
        }
        if a_next.is_empty() || b_next.is_empty() {
            return a_next.len().cmp(&b_next.len()).then_with(|| a.cmp(b));
        }
        (a_rest, b_rest) = (a_next, b_next);
    }
}

/// Text up to the first digit, the digits, and the rest.
fn split(s: &str) -> (&str, &str, &str) {
    let start = s.find(|c: char| c.is_ascii_digit()).unwrap_or(s.len());
    let (text, rest) = s.split_at(start);
    let end = rest
        .find(|c: char| !c.is_ascii_digit())
        .unwrap_or(rest.len());
    let (digits, rest) = rest.split_at(end);
    (text, digits, rest)
}

#[cfg(test)]
mod tests {
    use super::{natural, read, read_text};
    use std::cmp::Ordering;
    use std::io::ErrorKind;

    #[test]
    fn regular_files_within_the_limit_alone_are_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        std::fs::write(&path, "four").unwrap();
        assert_eq!(read(&path, 4).unwrap(), b"four");
        assert!(
            read(&path, 3)
                .unwrap_err()
                .to_string()
                .contains("above the limit")
        );
        assert_eq!(
            read(dir.path(), 4).unwrap_err().kind(),
            ErrorKind::IsADirectory
        );
        assert_eq!(
            read(&dir.path().join("none"), 4).unwrap_err().kind(),
            ErrorKind::NotFound
        );
        std::fs::write(&path, [b'a', 0xff]).unwrap();
        assert!(
            read_text(&path, 4)
                .unwrap_err()
                .to_string()
                .contains("byte 1")
        );
    }

    #[cfg(unix)]
    #[test]
    fn pipes_and_devices_are_refused_without_being_opened() {
        let dir = tempfile::tempdir().unwrap();
        let pipe = dir.path().join("pipe");
        assert!(
            std::process::Command::new("mkfifo")
                .arg(&pipe)
                .status()
                .unwrap()
                .success()
        );
        for (path, word) in [
            (pipe.as_path(), "a pipe"),
            (std::path::Path::new("/dev/zero"), "a device"),
        ] {
            let error = read(path, u64::MAX).unwrap_err();
            assert!(
                error.kind() == ErrorKind::InvalidData && error.to_string().contains(word),
                "{error}"
            );
        }
    }

    #[test]
    fn natural_order_compares_numbers() {
        let want = ["abc", "img", "img1a3", "img1a20", "img002", "img2", "img10"];
        let mut names = want;
        names.reverse();
        names.sort_by(|a, b| natural(a, b));
        assert_eq!(names, want);
        let (less, more) = ("99999999999999999999998", "99999999999999999999999");
        assert_eq!(natural(less, more), Ordering::Less);
    }
}
