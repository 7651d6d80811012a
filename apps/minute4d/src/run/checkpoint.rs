//! Writes checkpoints and `metrics.jsonl` during training, and resumes from them.

use super::folder;
use m4_core::{Capture, Progress};
use m4_io::scene::safetensors::{self, SceneFile};
use m4_io::{atomic, files};
use m4_kernels::SimdLevel;
use m4_train::{MetricsEvent, TrainConfig, Trainer};
use minute4d::Error;
use minute4d::json::MAX_RECORD_BYTES;
use minute4d::layout;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

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
        Self {
            folder: folder.to_path_buf(),
            key: key.to_owned(),
            keep: keep.max(1),
        }
    }

    /// A trainer that resumes from the newest checkpoint that can be read and belongs to this
    /// stage. Warns about checkpoints that cannot be used.
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
            let SceneFile {
                scene,
                state: Some(state),
                metadata,
                ..
            } = file
            else {
                continue;
            };
            if metadata.get(KEY) != Some(&self.key) {
                continue;
            }
            return Ok(Some(Trainer::resume(
                capture,
                scene.splats,
                &state,
                config.clone(),
                level,
            )?));
        }
        Ok(None)
    }

    /// Saves, then removes all but the newest. Where the disk is full, all but the newest make
    /// room.
    pub fn save(&mut self, trainer: &mut Trainer<'_>) -> Result<(), Error> {
        let path = folder::checkpoint_file(&self.folder, trainer.iteration());
        let metadata = BTreeMap::from([(KEY.to_owned(), self.key.clone())]);
        let mut write = || {
            trainer.save(|scene, state| safetensors::write(&path, scene, Some(state), &metadata))
        };
        if let Err(error) = write() {
            if !error.wants_room() {
                return Err(error.into());
            }
            let all = folder::checkpoints(&self.folder);
            let Some((_, older)) = all.split_last().filter(|(_, older)| !older.is_empty()) else {
                return Err(error.into());
            };
            for (_, old) in older {
                layout::remove_file(old)?;
            }
            write()?;
        }
        let all = folder::checkpoints(&self.folder);
        for (_, old) in &all[..all.len().saturating_sub(self.keep)] {
            layout::remove_file(old)?;
        }
        Ok(())
    }
}

/// `metrics.jsonl`: the events of a run so far, one per line.
pub(super) struct MetricsLog {
    path: PathBuf,
    lines: Vec<String>,
}

impl MetricsLog {
    /// An empty log.
    pub fn new(path: &Path) -> Self {
        Self {
            path: path.to_path_buf(),
            lines: Vec::new(),
        }
    }

    /// The log of an interrupted run, up to the iteration that was saved.
    pub fn up_to(path: &Path, iteration: usize) -> Self {
        let text = files::read_text(path, MAX_RECORD_BYTES).unwrap_or_default();
        let is_earlier = |line: &&str| {
            serde_json::from_str::<MetricsEvent>(line).is_ok_and(|e| e.iteration <= iteration)
        };
        Self {
            path: path.to_path_buf(),
            lines: text.lines().filter(is_earlier).map(str::to_owned).collect(),
        }
    }

    /// Adds an event.
    pub fn push(&mut self, event: &MetricsEvent) {
        if let Ok(line) = serde_json::to_string(event) {
            self.lines.push(line);
        }
    }

    /// Writes the file, whole or not at all.
    pub fn write(&self) -> Result<(), Error> {
        let text: String = self
            .lines
            .iter()
            .flat_map(|line| [line.as_str(), "\n"])
            .collect();
        atomic::write(&self.path, text.as_bytes()).map_err(Error::write(&self.path))
    }
}

#[cfg(test)]
mod tests {
    use super::MetricsLog;
    use m4_train::MetricsEvent;

    fn event(iteration: usize) -> MetricsEvent {
        MetricsEvent {
            iteration,
            loss: 0.25,
            l1: 0.1,
            ssim: 0.9,
            psnr: 30.0,
            splats_static: 5,
            splats_dynamic: 2,
            touched: 4.0,
            seconds: 1.0,
            processor_seconds: 2.0,
        }
    }

    #[test]
    fn resumed_log_drops_unsaved_entries() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("metrics.jsonl");
        let mut log = MetricsLog::new(&path);
        log.write().unwrap();
        assert_eq!(
            std::fs::read(&path).unwrap(),
            b"",
            "no line without an event"
        );
        for i in [50, 100, 150] {
            log.push(&event(i));
        }
        log.write().unwrap();
        let mut resumed = MetricsLog::up_to(&path, 100);
        resumed.push(&event(150));
        resumed.write().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let iterations: Vec<usize> = text
            .lines()
            .map(|l| serde_json::from_str::<MetricsEvent>(l).unwrap().iteration)
            .collect();
        assert_eq!(iterations, [50, 100, 150]);
    }
}
