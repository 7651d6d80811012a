//! Finished steps of a stage, kept on disk until the stage is done, so that an interrupted stage continues after the last one.
//!
//! A step is a file `.minute4d-steps/NAME` next to the result: magic, a hash, the warnings, and
//! the value. The hash covers the stage's key, the name and the bytes, so a damaged file, one of another input and one of
//! other settings all count as missing. Values are restored bit by bit, so the result of an interrupted run equals
//! that of an uninterrupted one. Steps only save time: a thread of their own writes them while the work goes on, and a failure to write
//! one is reported once.

mod writer;

use crate::Observer;
use crate::record::MAX_RECORD_BYTES;
use crate::stage::RecordingObserver;
use m4_io::files;
use serde::{Serialize, de::DeserializeOwned};
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

/// The finished steps of one stage.
pub(crate) struct Steps<'a> {
    folder: PathBuf,
    key: String,
    observer: &'a dyn Observer,
    /// False after a failed write.
    usable: AtomicBool,
    writer: Writer,
}

impl<'a> Steps<'a> {
    /// Opens the steps of the stage with this key whose result goes to `folder`; steps of another key are removed.
    pub fn open(folder: &Path, key: &str, observer: &'a dyn Observer) -> Self {
        let place = folder.join(FOLDER);
        let writer = Writer::new(place.clone());
        let steps = Self { folder: place, key: key.to_owned(), observer, usable: AtomicBool::new(true), writer };
        let of_key =
            files::read(&steps.folder.join(KEY_FILE), MAX_RECORD_BYTES).is_ok_and(|found| found == key.as_bytes());
        if !of_key {
            Self::remove_from(folder);
            let made =
                fs::create_dir_all(&steps.folder).and_then(|()| write(&steps.folder, KEY_FILE, &[key.as_bytes()]));
            if let Err(error) = made {
                steps.give_up(&error);
            }
        }
        steps
    }

    /// Returns the value of a step: from disk, with its warnings repeated, or computed by `work` and stored. Warnings of
    /// `work` go to the observer that it is given.
    pub fn keep<T: Serialize + DeserializeOwned, E>(
        &self,
        name: &str,
        work: impl FnOnce(&dyn Observer) -> Result<T, E>,
    ) -> Result<T, E> {
        if let Some((warnings, value)) = self.load::<(Vec<String>, T)>(name) {
            for warning in &warnings {
                self.observer.warn(warning);
            }
            return Ok(value);
        }
        let keeper = RecordingObserver::new(self.observer);
        let value = work(&keeper)?;
        self.store(name, &(keeper.warnings(), &value));
        Ok(value)
    }

    /// Returns a stored value, bit by bit.
    pub fn load<T: DeserializeOwned>(&self, name: &str) -> Option<T> {
        postcard::from_bytes(&self.get(name)?).ok()
    }

    /// Stores a value.
    pub fn store(&self, name: &str, value: &impl Serialize) {
        // One that cannot be serialised is computed again.
        if let Ok(bytes) = postcard::to_stdvec(value) {
            self.put(name, bytes);
        }
    }

    /// Receives progress and warnings, and says when to stop.
    pub fn observer(&self) -> &'a dyn Observer {
        self.observer
    }

    /// Returns whether finished steps are kept beside the result in `folder`.
    pub fn exist(folder: &Path) -> bool {
        let names = fs::read_dir(folder.join(FOLDER)).into_iter().flatten().flatten().map(|entry| entry.file_name());
        names.filter_map(|name| name.into_string().ok()).any(|name| name != KEY_FILE && !name.ends_with(PART))
    }

    /// Removes the steps beside the result in `folder`, when the stage is done or its key has changed; only those, which have a key. What
    /// cannot be removed is part of no result, and is removed or used by the next attempt.
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
            self.observer.warn(&format!(
                "finished steps cannot be kept in {}: {error}; if this run is interrupted now, it does them again",
                self.folder.display()
            ));
        }
    }

    /// Waits until every step is written.
    fn settle(&self) {
        if let Some(error) = self.writer.settle() {
            self.give_up(&error);
        }
    }

    /// Returns stored bytes; `None` if there are none or they are damaged.
    pub fn get(&self, name: &str) -> Option<Vec<u8>> {
        self.settle();
        let mut file = files::read(&self.path(name), u64::MAX).ok()?;
        let bytes = file.get(MAGIC.len() + HASH..)?;
        let whole = file.starts_with(MAGIC) && file[MAGIC.len()..][..HASH] == *hash(&self.key, name, bytes).as_bytes();
        whole.then(|| file.split_off(MAGIC.len() + HASH))
    }

    /// Stores bytes, which are on disk a little later.
    pub fn put(&self, name: &str, bytes: Vec<u8>) {
        if !self.usable.load(Ordering::Relaxed) {
            return;
        }
        let (key, step) = (self.key.clone(), name.to_owned());
        let failed = self
            .writer
            .push(move |folder| write(folder, &step, &[MAGIC, hash(&key, &step, &bytes).as_bytes(), &bytes]));
        if let Some(error) = failed {
            self.give_up(&error);
        }
    }
}

impl Drop for Steps<'_> {
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
    use super::Steps;
    use crate::{Observer, StageEvent};
    use m4_core::{Flow, Progress};
    use std::convert::Infallible;
    use std::fs;
    use std::sync::Mutex;

    #[derive(Default)]
    struct Heard(Mutex<Vec<String>>);

    impl Progress for Heard {
        fn update(&self, _: &str, _: usize, _: usize, _: &str) {}

        fn warn(&self, message: &str) {
            self.0.lock().unwrap().push(message.to_owned());
        }

        fn cancelled(&self) -> bool {
            false
        }
    }

    impl Observer for Heard {
        fn stage(&self, _: &str, _: StageEvent<'_>) {}
    }

    fn step(steps: &Steps<'_>, value: f64) -> f64 {
        let made = steps.keep("cameras", |observer| {
            observer.warn("blurred");
            Ok::<_, Infallible>(value)
        });
        made.unwrap()
    }

    #[test]
    fn a_step_is_made_once_and_its_warnings_are_said_again() {
        let dir = tempfile::tempdir().unwrap();
        let heard = Heard::default();
        let nan = f64::from_bits(0x7ff8_0000_dead_beef);
        assert_eq!(step(&Steps::open(dir.path(), "k", &heard), nan).to_bits(), nan.to_bits());
        let again = Steps::open(dir.path(), "k", &heard);
        assert_eq!(step(&again, 1.0).to_bits(), nan.to_bits(), "from disk, bit by bit");
        assert_eq!(*heard.0.lock().unwrap(), ["blurred", "blurred"]);
        assert_eq!(step(&Steps::open(dir.path(), "other", &heard), 2.0), 2.0, "another key");
        let last = Steps::open(dir.path(), "other", &heard);
        drop(last);
        Steps::remove_from(dir.path());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[test]
    fn flow_comes_back_bit_by_bit() {
        let dir = tempfile::tempdir().unwrap();
        let heard = Heard::default();
        let steps = Steps::open(dir.path(), "k", &heard);
        let numbers = |offset: u32| (0..35).map(|i| f32::from_bits(0x7f80_0000 - 17 + offset + i)).collect();
        let flow = Flow { width: 7, height: 5, u: numbers(0), v: numbers(1) };
        steps.store("flow", &flow);
        let back: Flow = steps.load("flow").unwrap();
        let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!((back.width, back.height), (7, 5));
        assert!(bits(&back.u) == bits(&flow.u) && bits(&back.v) == bits(&flow.v));
        // as another type it is not there
        assert!(steps.load::<Vec<Vec<f32>>>("flow").is_none());
    }

    #[test]
    fn a_torn_step_is_not_there() {
        let dir = tempfile::tempdir().unwrap();
        let heard = Heard::default();
        let steps = Steps::open(dir.path(), "k", &heard);
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
        let steps = Steps::open(dir.path(), "k", &heard);
        assert_eq!(step(&steps, 3.0), 3.0);
        steps.put("more", vec![1]);
        drop(steps);
        let said = heard.0.lock().unwrap();
        assert_eq!(said.iter().filter(|s| s.contains("cannot be kept")).count(), 1, "{said:?}");
    }
}
