//! Writes checkpoints during training, and resumes from them.

use crate::{Error, Observer, folder};
use m4_core::{Capture, Progress};
use m4_io::scene::safetensors::{self, SceneFile};
use m4_kernels::SimdLevel;
use m4_train::{TrainConfig, Trainer};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Name of the key in the metadata of a scene file.
const KEY: &str = "minute4d.train_key";

/// The checkpoints of a run.
pub(super) struct Checkpoints {
    folder: PathBuf,
    key: String,
    keep: usize,
}

impl Checkpoints {
    /// Those in `folder` that belong to the stage with this key.
    pub fn new(folder: &Path, key: &str, keep: usize) -> Self {
        Self { folder: folder.to_path_buf(), key: key.to_owned(), keep: keep.max(1) }
    }

    /// A trainer that resumes from the newest checkpoint that can be read and belongs to this stage.
    /// Warns about checkpoints that cannot be used.
    pub fn latest<'a>(
        &self,
        capture: &'a Capture,
        config: &TrainConfig,
        level: SimdLevel,
        progress: &dyn Progress,
    ) -> Result<Option<Trainer<'a>>, Error> {
        for (_, path) in folder::checkpoints(&self.folder).into_iter().rev() {
            let file = match safetensors::read(&path) {
                Ok(file) => file,
                Err(error) => {
                    progress.warn(&format!("a checkpoint cannot be used: {error}"));
                    continue;
                }
            };
            let SceneFile { scene, state: Some(state), metadata, .. } = file else {
                continue;
            };
            if metadata.get(KEY) != Some(&self.key) {
                continue;
            }
            return Ok(Some(Trainer::resume(capture, scene.splats, &state, config.clone(), level)?));
        }
        Ok(None)
    }

    /// Saves, then removes all but the newest. Where the disk is full, all but the newest make room.
    pub fn save(&mut self, trainer: &mut Trainer<'_>) -> Result<(), Error> {
        let path = folder::checkpoint_file(&self.folder, trainer.iteration());
        let metadata = BTreeMap::from([(KEY.to_owned(), self.key.clone())]);
        let mut write = || trainer.save(|scene, state| safetensors::write(&path, scene, Some(state), &metadata));
        if let Err(error) = write() {
            if !error.wants_room() {
                return Err(error.into());
            }
            let all = folder::checkpoints(&self.folder);
            let Some((_, older)) = all.split_last().filter(|(_, older)| !older.is_empty()) else {
                return Err(error.into());
            };
            for (_, old) in older {
                folder::remove_file(old)?;
            }
            write()?;
        }
        let all = folder::checkpoints(&self.folder);
        for (_, old) in &all[..all.len().saturating_sub(self.keep)] {
            folder::remove_file(old)?;
        }
        Ok(())
    }
}

/// Stops a trainer when it is time for a checkpoint, when a page requests the scene, or when the
/// user says so.
pub(super) struct CheckpointTimer<'a> {
    inner: &'a dyn Progress,
    observer: &'a dyn Observer,
    until: Instant,
    /// Training asks before every step; the first step is always taken, however short the wait.
    asked: AtomicBool,
}

impl<'a> CheckpointTimer<'a> {
    /// Lasts for this many seconds.
    pub fn new(inner: &'a dyn Progress, observer: &'a dyn Observer, seconds: f64) -> Self {
        const LONGEST: Duration = Duration::from_secs(1 << 31);
        let wait = Duration::try_from_secs_f64(seconds).unwrap_or(LONGEST).min(LONGEST);
        Self { inner, observer, until: Instant::now() + wait, asked: AtomicBool::new(false) }
    }

    /// The same, but not beyond `end`.
    pub fn at_most(self, end: Option<Instant>) -> Self {
        let until = end.map_or(self.until, |end| end.min(self.until));
        Self { until, ..self }
    }

    /// True when it is time for a checkpoint.
    pub fn is_over(&self) -> bool {
        Instant::now() >= self.until
    }

    /// Allows the trainer another step, whatever the time is.
    pub fn take_a_step(&self) {
        self.asked.store(false, Ordering::Relaxed);
    }

    /// True if the user asked to stop.
    pub fn stopped_by_user(&self) -> bool {
        self.inner.cancelled()
    }
}

impl Progress for CheckpointTimer<'_> {
    fn update(&self, phase: &str, done: usize, total: usize, note: &str) {
        self.inner.update(phase, done, total, note);
    }

    fn warn(&self, message: &str) {
        self.inner.warn(message);
    }

    fn cancelled(&self) -> bool {
        let due = || self.is_over() || self.observer.wants_scene();
        self.inner.cancelled() || (self.asked.swap(true, Ordering::Relaxed) && due())
    }
}

#[cfg(test)]
mod tests {
    use super::CheckpointTimer;
    use m4_core::{Progress, Silent};

    #[test]
    fn at_least_one_step_is_allowed_per_interval() {
        let patience = CheckpointTimer::new(&Silent, &Silent, 0.0);
        assert!(!patience.cancelled());
        assert!(patience.cancelled() && !patience.stopped_by_user() && patience.is_over());
        patience.take_a_step();
        assert!(!patience.cancelled(), "one more");
        let endless = CheckpointTimer::new(&Silent, &Silent, f64::INFINITY);
        assert!(!endless.cancelled() && !endless.cancelled());
    }
}
