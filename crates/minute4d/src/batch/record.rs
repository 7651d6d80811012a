//! The outcome of a job: `.state/ID.json`.

use crate::batch::error::BatchError;
use crate::batch::manifest::VERSION;
use m4_io::atomic;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::fs;
use std::io::ErrorKind;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// The outcome of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The result is published.
    Done,
    /// A permanent failure, for which the clip's own bytes are the evidence: it is not run again unless forced.
    Failed,
    /// The machine could not do it, or it was stopped: a note only, which does not prevent another run.
    Retryable,
}

/// The record of a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JobRecord {
    /// [`VERSION`].
    pub version: u32,
    /// The job.
    pub id: String,
    /// Hash of input and settings that all this is of; another one starts again.
    pub key: String,
    /// The outcome.
    pub outcome: Outcome,
    /// The reason.
    pub reason: String,
    /// Exit code of the run, where it had one.
    pub code: Option<i32>,
    /// Wall-clock seconds that it took.
    pub seconds: f64,
    /// The machine.
    pub host: String,
    /// When it ended, seconds since 1970.
    pub when_s: u64,
}

impl JobRecord {
    /// The record, if there is one that this release can use and that is of this input and these settings.
    pub(crate) fn read(path: &Path, key: &str) -> Result<Option<Self>, BatchError> {
        Ok(read_json::<Self>(path)?.filter(|r| r.version == VERSION && r.key == key))
    }
}

/// Seconds since 1970 by this machine's clock.
pub(crate) fn now_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs())
}

/// Reads JSON; `None` where there is no file or it holds something else.
pub(crate) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, BatchError> {
    match fs::read(path) {
        Ok(bytes) => Ok(serde_json::from_slice(&bytes).ok()),
        Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(None),
        Err(source) => Err(BatchError::read(path)(source)),
    }
}

/// Writes JSON, whole or not at all.
pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), BatchError> {
    let text = serde_json::to_string_pretty(value).map_err(|e| BatchError::write(path)(e.into()))? + "\n";
    atomic::write(path, text.as_bytes()).map_err(BatchError::write(path))
}
