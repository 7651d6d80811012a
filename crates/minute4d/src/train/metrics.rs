//! `metrics.jsonl`: one event per line, written at every checkpoint.

use crate::Error;
use m4_io::atomic;
use m4_train::MetricsEvent;
use std::fs;
use std::path::{Path, PathBuf};

/// The events of a run so far.
#[derive(Debug)]
pub(super) struct MetricsLog {
    path: PathBuf,
    lines: Vec<String>,
}

impl MetricsLog {
    /// An empty log.
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_path_buf(), lines: Vec::new() }
    }

    /// The log of an interrupted run, up to the iteration that was saved.
    pub fn up_to(path: &Path, iteration: usize) -> Self {
        let text = fs::read_to_string(path).unwrap_or_default();
        let kept = |line: &&str| serde_json::from_str::<MetricsEvent>(line).is_ok_and(|e| e.iteration <= iteration);
        Self { path: path.to_path_buf(), lines: text.lines().filter(kept).map(str::to_owned).collect() }
    }

    /// Adds an event.
    pub fn push(&mut self, event: &MetricsEvent) {
        if let Ok(line) = serde_json::to_string(event) {
            self.lines.push(line);
        }
    }

    /// Writes the file, whole or not at all.
    pub fn write(&self) -> Result<(), Error> {
        let text: String = self.lines.iter().flat_map(|line| [line.as_str(), "\n"]).collect();
        atomic::write(&self.path, text.as_bytes()).map_err(|source| Error::Write { path: self.path.clone(), source })
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
        assert_eq!(std::fs::read(&path).unwrap(), b"", "no line without an event");
        for i in [50, 100, 150] {
            log.push(&event(i));
        }
        log.write().unwrap();
        let mut resumed = MetricsLog::up_to(&path, 100);
        resumed.push(&event(150));
        resumed.write().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let found: Vec<usize> =
            text.lines().map(|l| serde_json::from_str::<MetricsEvent>(l).unwrap().iteration).collect();
        assert_eq!(found, [50, 100, 150]);
    }
}
