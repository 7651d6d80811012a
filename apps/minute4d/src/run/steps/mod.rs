//! Finished steps of a stage, kept on disk until the stage is done, so that an interrupted stage
//! continues after the last one.
//!
//! A step is a file `.minute4d-steps/NAME` next to the result: magic, a hash, the warnings, and the
//! value. The hash covers the stage's key, the name and the bytes, so a damaged file, one of
//! another input and one of other settings all count as missing. Values are restored bit by bit, so
//! the result of an interrupted run equals that of an uninterrupted one. Steps only save time: a
//! thread of their own writes them while the work goes on, and a failure to write one is reported
//! once.

mod writer;

use m4_core::Progress;
use m4_io::files;
use minute4d::cache::StepCache;
use minute4d::json::MAX_RECORD_BYTES;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use writer::{PART, Writer, write};

/// The hidden folder.
const FOLDER: &str = ".minute4d-steps";
/// The file with the key of the stage that the steps belong to.
const KEY_FILE: &str = "key";
/// The magic bytes of a step: the format and its version.
const MAGIC: &[u8; 8] = b"m4step02";
/// Length of the hash.
const HASH: usize = 32;

/// The folder of the finished steps of one stage.
pub(crate) struct StepFolder<'a> {
    folder: PathBuf,
    key: String,
    progress: &'a dyn Progress,
    /// False after a failed write.
    usable: AtomicBool,
    writer: Writer,
}

impl<'a> StepFolder<'a> {
    /// Opens the steps of the stage with this key whose result goes to `folder`; steps of another
    /// key are removed.
    pub fn open(folder: &Path, key: &str, progress: &'a dyn Progress) -> Self {
        let place = folder.join(FOLDER);
        let writer = Writer::new(place.clone());
        let steps = Self {
            folder: place,
            key: key.to_owned(),
            progress,
            usable: AtomicBool::new(true),
            writer,
        };
        let of_key = files::read(&steps.folder.join(KEY_FILE), MAX_RECORD_BYTES)
            .is_ok_and(|bytes| bytes == key.as_bytes());
        if !of_key {
            Self::remove_from(folder);
            let result = fs::create_dir_all(&steps.folder)
                .and_then(|()| write(&steps.folder, KEY_FILE, &[key.as_bytes()]));
            if let Err(error) = result {
                steps.give_up(&error);
            }
        }
        steps
    }

    /// Returns whether finished steps are kept beside the result in `folder`.
    pub fn exist(folder: &Path) -> bool {
        let names = fs::read_dir(folder.join(FOLDER))
            .into_iter()
            .flatten()
            .flatten()
            .map(|entry| entry.file_name());
        names
            .filter_map(|name| name.into_string().ok())
            .any(|name| name != KEY_FILE && !name.ends_with(PART))
    }

    /// Removes the steps beside the result in `folder`, when the stage is done or its key has
    /// changed; only those, which have a key. What cannot be removed is part of no result, and is
    /// removed or used by the next attempt.
    pub fn remove_from(folder: &Path) {
        let steps = folder.join(FOLDER);
        if steps.join(KEY_FILE).is_file() {
            let _ = fs::remove_dir_all(&steps);
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Warns that steps are no longer stored.
    fn give_up(&self, error: &io::Error) {
        if self.usable.swap(false, Ordering::Relaxed) {
            self.progress.warn(&format!(
                "finished steps cannot be kept in {}: {error}; if this run is interrupted now, it does them again",
                self.folder.display()
            ));
        }
    }

    /// Waits until every step is written.
    fn settle(&self) {
        if let Err(error) = self.writer.settle() {
            self.give_up(&error);
        }
    }
}

impl StepCache for StepFolder<'_> {
    fn get(&self, name: &str) -> Option<Vec<u8>> {
        self.settle();
        let mut file = files::read(&self.path(name), u64::MAX).ok()?;
        let bytes = file.get(MAGIC.len() + HASH..)?;
        let whole = file.starts_with(MAGIC)
            && file[MAGIC.len()..][..HASH] == *hash(&self.key, name, bytes).as_bytes();
        whole.then(|| file.split_off(MAGIC.len() + HASH))
    }

    fn put(&self, name: &str, bytes: Vec<u8>) {
        if !self.usable.load(Ordering::Relaxed) {
            return;
        }
        let (key, step) = (self.key.clone(), name.to_owned());
        let written = self.writer.push(move |folder| {
            write(
                folder,
                &step,
                &[MAGIC, hash(&key, &step, &bytes).as_bytes(), &bytes],
            )
        });
        if let Err(error) = written {
            self.give_up(&error);
        }
    }
}

impl Drop for StepFolder<'_> {
    fn drop(&mut self) {
        self.settle();
    }
}

/// The hash of a step.
fn hash(key: &str, name: &str, bytes: &[u8]) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    for part in [key.as_bytes(), name.as_bytes(), bytes] {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part);
    }
    hasher.finalize()
}

#[cfg(test)]
mod tests {
    use super::StepFolder;
    use m4_testkit::Heard;
    use minute4d::cache::StepCache;
    use std::fs;

    #[test]
    fn steps_of_another_key_are_removed() {
        let dir = tempfile::tempdir().unwrap();
        let heard = Heard::default();
        let steps = StepFolder::open(dir.path(), "k", &heard);
        steps.put("flow", vec![7; 100]);
        drop(steps);
        assert_eq!(
            StepFolder::open(dir.path(), "k", &heard).get("flow"),
            Some(vec![7; 100])
        );
        assert_eq!(
            StepFolder::open(dir.path(), "other", &heard).get("flow"),
            None,
            "another key"
        );
        assert_eq!(
            StepFolder::open(dir.path(), "k", &heard).get("flow"),
            None,
            "removed"
        );
        StepFolder::remove_from(dir.path());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_torn_step_is_not_there() {
        let dir = tempfile::tempdir().unwrap();
        let heard = Heard::default();
        let steps = StepFolder::open(dir.path(), "k", &heard);
        steps.put("flow", vec![7; 100]);
        steps.settle();
        let path = dir.path().join(".minute4d-steps/flow");
        let whole = fs::read(&path).unwrap();
        for length in 0..whole.len() {
            fs::write(&path, &whole[..length]).unwrap();
            assert_eq!(steps.get("flow"), None, "{length} bytes");
        }
        for place in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[place] ^= 1;
            fs::write(&path, &bytes).unwrap();
            assert_eq!(steps.get("flow"), None, "byte {place}");
        }
        // of another name
        fs::write(dir.path().join(".minute4d-steps/fl0w"), &whole).unwrap();
        assert_eq!(steps.get("fl0w"), None);
        fs::write(&path, &whole).unwrap();
        assert_eq!(steps.get("flow"), Some(vec![7; 100]));
    }

    #[test]
    fn a_cache_write_failure_is_reported_once() {
        let dir = tempfile::tempdir().unwrap();
        let heard = Heard::default();
        fs::write(dir.path().join(".minute4d-steps"), "in the way").unwrap();
        let steps = StepFolder::open(dir.path(), "k", &heard);
        steps.put("more", vec![1]);
        drop(steps);
        let said = heard.all();
        assert_eq!(said.matches("cannot be kept").count(), 1, "{said}");
    }
}
