//! Reads whole files within a limit, lists the files of a folder, and works on frames in parallel.

use crate::error::AtPath;
use crate::{Fault, ReadError};
use m4_core::Progress;
use rayon::prelude::*;
use serde::de::DeserializeOwned;
use std::cmp::Ordering;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::{self, AtomicUsize};

/// Longest list of frames that is read, bytes: a frame takes some kilobytes, and a hundred thousand frames are no clip.
const MAX_TEXT_BYTES: u64 = 256 << 20;

/// The bytes of a regular file of at most `limit_bytes`: devices and pipes, which may never end, are refused.
pub(crate) fn bytes(path: &Path, limit_bytes: u64) -> Result<Vec<u8>, Fault> {
    let file = File::open(path)?;
    let facts = file.metadata()?;
    if !facts.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "it is not a regular file").into());
    }
    if facts.len() > limit_bytes {
        let (found, limit) = (facts.len() >> 20, limit_bytes >> 20);
        let what = format!("it has {found} MiB, above the limit of {limit} MiB");
        return Err(Fault::bad(what, "check that this is the right file"));
    }
    let mut bytes = Vec::new();
    file.take(facts.len()).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// A text file.
pub(crate) fn text(path: &Path) -> Result<String, ReadError> {
    String::from_utf8(bytes(path, MAX_TEXT_BYTES).at(path)?).map_err(|e| {
        let place = format!("byte {}", e.utf8_error().valid_up_to());
        Fault::bad("it is not text (UTF-8)", "give the text file that the tool wrote").within(path, place)
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

/// The files of a folder whose extension is one of `extensions` (small letters), in natural order: `2.png` before `10.png`.
/// Hidden files are passed over; an empty list is no error.
pub(crate) fn listed(folder: &Path, extensions: &[&str]) -> Result<Vec<PathBuf>, ReadError> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).at(folder)? {
        let file = entry.at(folder)?.path();
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
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
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
    if let Ok(file) = File::open(path) {
        // what cannot be read is of no format
        let _ = file.take(N as u64).read_to_end(&mut start);
    }
    start
}

/// Calls `one` for each of `frames` and its index, in parallel; the results in order, or the first error (`stopped`).
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
        let order = a_text.cmp(b_text).then_with(|| number(a_digits).cmp(&number(b_digits)));
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
    let end = rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len());
    let (digits, rest) = rest.split_at(end);
    (text, digits, rest)
}

#[cfg(test)]
mod tests {
    use super::natural;
    use std::cmp::Ordering;

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
