//! Hashes of inputs and settings: the cache keys of finished stages.

use crate::Error;
use crate::layout::GEOMETRY_FILE;
use crate::observer::check_stop;
use m4_core::{Capture, CaptureFrame, CompactDepth, CompactMask, Plane, Progress, Silent};
use m4_io::files;
use rayon::prelude::*;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Returns the BLAKE3 hash of a file's bytes, or of the names and bytes of everything in a folder;
/// hexadecimal.
///
/// Hidden files and the program's own records are left out.
///
/// # Errors
///
/// [`Error::Read`] naming the file that could not be read.
pub fn of_path(path: &Path) -> Result<String, Error> {
    of_input(path, None, &Silent)
}

/// The same of an input, which may be large: ends where the caller asks to stop. Results may be in
/// the folder that they are made from: the folder `out` in it is left out.
///
/// # Errors
///
/// As [`of_path`], and [`Error::Stopped`].
pub fn of_input(path: &Path, out: Option<&Path>, watch: &dyn Progress) -> Result<String, Error> {
    let mut hasher = blake3::Hasher::new();
    if path.is_dir() {
        let mut files = Vec::new();
        let out = out.and_then(|out| out.canonicalize().ok());
        list(path, Path::new(""), out.as_deref(), &mut files)?;
        files.sort();
        for relative in files {
            let name = relative.to_string_lossy().replace('\\', "/");
            let mut inner = blake3::Hasher::new();
            read_into(&path.join(&relative), &mut inner, watch)?;
            hasher.update(&(name.len() as u64).to_le_bytes());
            hasher.update(name.as_bytes());
            hasher.update(inner.finalize().as_bytes());
        }
    } else {
        read_into(path, &mut hasher, watch)?;
    }
    Ok(hasher.finalize().to_hex().to_string())
}

/// Returns the BLAKE3 hash of several texts, which depends on the boundaries between them.
pub fn of_parts(parts: &[&str]) -> String {
    let mut hasher = blake3::Hasher::new();
    for part in parts {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part.as_bytes());
    }
    hasher.finalize().to_hex().to_string()
}

/// Returns the BLAKE3 hash of everything that training reads of a capture: cameras, times, images,
/// depth, masks and tracks.
pub fn of_capture(capture: &Capture) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&(capture.time_frames as u64).to_le_bytes());
    let frames: Vec<blake3::Hash> = capture.frames.par_iter().map(of_frame).collect();
    for frame in frames {
        hasher.update(frame.as_bytes());
    }
    // Without tracks the hash is what it was before there were any.
    if let Some(tracks) = &capture.tracks {
        size_into((tracks.frames(), tracks.count()), &mut hasher);
        hasher.update(
            &tracks
                .xyz()
                .as_flattened()
                .iter()
                .flat_map(|v| v.to_le_bytes())
                .collect::<Vec<u8>>(),
        );
        hasher.update(
            &tracks
                .visible()
                .iter()
                .map(|&v| u8::from(v))
                .collect::<Vec<u8>>(),
        );
    }
    hasher.finalize().to_hex().to_string()
}

fn of_frame(frame: &CaptureFrame) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    let k = &frame.camera.intrinsics;
    size_into((k.width, k.height), &mut hasher);
    let pose = &frame.camera.c2w;
    let numbers = [k.fx, k.fy, k.cx, k.cy, frame.t];
    for x in numbers
        .iter()
        .chain(pose.rotation.iter())
        .chain(pose.translation.iter())
    {
        hasher.update(&x.to_le_bytes());
    }
    size_into(frame.rgb.size(), &mut hasher);
    hasher.update(frame.rgb.data().as_flattened());
    size_into(
        frame.depth.as_ref().map_or((0, 0), CompactDepth::size),
        &mut hasher,
    );
    if let Some(depth) = &frame.depth {
        hasher.update(
            &depth
                .every(1)
                .flat_map(f32::to_le_bytes)
                .collect::<Vec<u8>>(),
        );
    }
    let mask = frame.mask.as_ref().map(CompactMask::to_mask);
    size_into(mask.as_ref().map_or((0, 0), Plane::size), &mut hasher);
    hasher.update(mask.as_ref().map_or(&[], Plane::data));
    hasher.finalize()
}

/// A capture with its hash, which takes a while.
pub struct HashedCapture {
    /// The capture.
    pub capture: Capture,
    /// [`of_capture`] of it.
    pub hash: String,
}

impl HashedCapture {
    /// Hashes a capture.
    pub fn new(capture: Capture) -> Self {
        Self {
            hash: of_capture(&capture),
            capture,
        }
    }
}

fn size_into((width, height): (usize, usize), hasher: &mut blake3::Hasher) {
    hasher.update(&(width as u64).to_le_bytes());
    hasher.update(&(height as u64).to_le_bytes());
}

fn read_into(path: &Path, hasher: &mut blake3::Hasher, watch: &dyn Progress) -> Result<(), Error> {
    let file = files::open(path).map_err(Error::read(path))?;
    let read = hasher.update_reader(Watched { file, watch });
    check_stop(watch, "the reading of the input", false)?;
    read.map_err(Error::read(path))?;
    Ok(())
}

/// A file that cannot be read any more after a stop.
struct Watched<'a> {
    file: File,
    watch: &'a dyn Progress,
}

impl Read for Watched<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        match self.watch.cancelled() {
            true => Err(io::Error::other("stopped")),
            false => self.file.read(bytes),
        }
    }
}

fn list(
    root: &Path,
    folder: &Path,
    out: Option<&Path>,
    files: &mut Vec<PathBuf>,
) -> Result<(), Error> {
    let full = root.join(folder);
    let failed = Error::read(&full);
    for entry in fs::read_dir(&full).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let name = entry.file_name();
        let text = name.to_string_lossy();
        // the record is not part of the input
        if text.starts_with('.') || text == GEOMETRY_FILE {
            continue;
        }
        let relative = folder.join(&name);
        // `metadata` follows links, so that a folder of links counts by what it shows.
        let kind = fs::metadata(entry.path()).map_err(Error::read(&entry.path()))?;
        if kind.is_dir() {
            if out.is_none_or(|out| entry.path().canonicalize().ok().as_deref() != Some(out)) {
                list(root, &relative, out, files)?;
            }
        } else if kind.is_file() {
            files.push(relative);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{of_input, of_parts, of_path};
    use m4_testkit::StopAtPoll;
    use std::fs;

    #[cfg(unix)]
    #[test]
    fn links_that_lead_in_a_circle_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let (a, b) = (dir.path().join("a.png"), dir.path().join("b.png"));
        std::os::unix::fs::symlink(&a, &b).unwrap();
        std::os::unix::fs::symlink(&b, &a).unwrap();
        let said = of_path(dir.path()).unwrap_err().to_string();
        assert!(said.contains("a.png") || said.contains("b.png"), "{said}");
        let missing = crate::Error::missing("capture", &a);
        assert!(
            missing
                .to_string()
                .ends_with("a.png, which is a link that leads nowhere, or in a circle"),
            "{missing}"
        );
        let missing = crate::Error::missing("capture", &dir.path().join("c"));
        assert!(missing.to_string().ends_with("/c"), "{missing}");
    }

    #[test]
    fn a_stop_ends_the_reading_of_a_large_input() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("clip.mp4");
        fs::write(&path, vec![7; 4 << 20]).unwrap();
        let stop = StopAtPoll::after(3);
        assert!(of_input(&path, None, &stop).unwrap_err().is_stop());
        assert_eq!(
            of_input(&path, None, &m4_core::Silent).unwrap(),
            of_path(&path).unwrap()
        );
    }

    #[test]
    fn folder_hash_covers_names_and_bytes() {
        let dir = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| fs::write(dir.path().join(name), text).unwrap();
        fs::create_dir(dir.path().join("in")).unwrap();
        write("a", "1");
        write("in/b", "2");
        let first = of_path(dir.path()).unwrap();
        write(".hidden", "3");
        write("geometry.json", "{}");
        assert_eq!(
            of_path(dir.path()).unwrap(),
            first,
            "records and hidden files do not count"
        );
        write("in/b", "22");
        let changed = of_path(dir.path()).unwrap();
        write("in/c", "result");
        let without = |out: &str| {
            of_input(dir.path(), Some(&dir.path().join(out)), &m4_core::Silent).unwrap()
        };
        assert!(
            without("in") == without("./in")
                && without("in") != changed
                && without("elsewhere") != changed
        );
        fs::remove_file(dir.path().join("in/c")).unwrap();
        assert_ne!(changed, first);
        fs::rename(dir.path().join("a"), dir.path().join("c")).unwrap();
        assert_ne!(of_path(dir.path()).unwrap(), changed);
        assert!(of_path(&dir.path().join("missing")).is_err());
    }

    #[test]
    fn borders_between_parts_count() {
        assert_ne!(of_parts(&["ab", "c"]), of_parts(&["a", "bc"]));
        assert_eq!(of_parts(&["ab", "c"]), of_parts(&["ab", "c"]));
    }
}
