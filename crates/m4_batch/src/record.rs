//! What came of a job: `.state/ID.json`.

use crate::error::FileError;
use crate::manifest::VERSION;
use m4_io::atomic;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::fs;
use std::io::ErrorKind;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// How an attempt at a job ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The result is published.
    Done,
    /// It will never work with this input and these settings; it is not tried again unasked.
    Poison,
    /// It crashed, and will be tried again.
    Failed,
    /// It was stopped, or this machine could not do it; another may go on with it.
    Interrupted,
}

/// What is kept of a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JobRecord {
    /// [`VERSION`].
    pub version: u32,
    /// The job.
    pub id: String,
    /// Hash of input and settings that all this is of; another one begins anew.
    pub key: String,
    /// How it ended.
    pub verdict: Verdict,
    /// Why.
    pub reason: String,
    /// Exit code of the run, where it had one.
    pub code: Option<i32>,
    /// Attempts that crashed.
    pub attempts: u32,
    /// Workers that vanished while they had the lease.
    pub vanished: u32,
    /// Wall-clock seconds of the last attempt.
    pub seconds: f64,
    /// Where the last attempt was made.
    pub host: String,
    /// When it ended, seconds since 1970.
    pub when_s: u64,
}

impl JobRecord {
    /// A job that nobody has tried yet.
    pub(crate) fn new(id: &str, key: &str, host: &str) -> Self {
        Self {
            version: VERSION,
            id: id.to_owned(),
            key: key.to_owned(),
            verdict: Verdict::Interrupted,
            reason: String::new(),
            code: None,
            attempts: 0,
            vanished: 0,
            seconds: 0.0,
            host: host.to_owned(),
            when_s: now_s(),
        }
    }

    /// The record, if there is one that this release can use and that is of this input and these settings.
    pub(crate) fn read(path: &Path, key: &str) -> Result<Option<Self>, FileError> {
        Ok(read_json::<Self>(path)?.filter(|r| r.version == VERSION && r.key == key))
    }

    /// Writes it, whole or not at all.
    pub(crate) fn write(&self, path: &Path) -> Result<(), FileError> {
        write_json(path, self)
    }
}

/// Seconds since 1970 by this machine's clock.
pub(crate) fn now_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs())
}

/// Reads JSON; `None` where there is no file or it holds something else.
pub(crate) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, FileError> {
    match fs::read(path) {
        Ok(bytes) => Ok(serde_json::from_slice(&bytes).ok()),
        Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(None),
        Err(source) => Err(FileError::read(path)(source)),
    }
}

/// Writes JSON, whole or not at all.
pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), FileError> {
    let failed = FileError::write(path);
    let text = match serde_json::to_string_pretty(value) {
        Ok(text) => text + "\n",
        Err(error) => return Err(failed(error.into())),
    };
    atomic::write(path, text.as_bytes()).map_err(failed)
}
