//! Downloads a file in as many attempts as it takes; what has arrived is kept for the next one.

use super::network::{Answer, Failure, Head, Network};
use super::{Entry, WeightsError};
use crate::json::read_json;
use crate::{Category, Refusal};
use m4_core::Progress;
use serde::{Deserialize, Serialize};
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

/// Attempts in a row that bring nothing.
const ATTEMPTS: u32 = 5;
/// Longest pause that a server may ask for.
const MAX_PAUSE: Duration = Duration::from_secs(120);
/// Interval at which a wait looks whether it should stop.
const POLL: Duration = Duration::from_millis(50);
/// Room that a disk keeps.
const SPARE_BYTES: u64 = 16 << 20;

/// What a server said of a file, beside the part of it that has arrived.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Served {
    url: String,
    etag: Option<String>,
    bytes: Option<u64>,
    /// SHA-256 of the file, where the server says it.
    pub sha256: Option<String>,
    /// The commit that it is of, where the server says it.
    pub commit: Option<String>,
}

/// Why an attempt ended.
enum Ended {
    /// Another one may succeed, after the pause that the server asks for.
    Broken {
        reason: String,
        pause: Option<Duration>,
    },
    Failed(WeightsError),
}

impl From<WeightsError> for Ended {
    fn from(error: WeightsError) -> Self {
        Self::Failed(error)
    }
}

impl From<Refusal> for Ended {
    fn from(refusal: Refusal) -> Self {
        Self::Failed(refusal.into())
    }
}

/// The download of one file into a folder that another attempt, or another run, continues.
pub(super) struct Download<'a> {
    pub entry: &'a Entry,
    pub network: &'a Network,
    pub folder: &'a Path,
    pub progress: &'a dyn Progress,
}

impl Download<'_> {
    /// The file, as far as it has arrived.
    pub fn part(&self) -> PathBuf {
        self.folder.join("part")
    }

    fn record(&self) -> PathBuf {
        self.folder.join("part.json")
    }

    /// Downloads all of the file.
    ///
    /// # Errors
    ///
    /// [`WeightsError`] if the host refuses, is not reached or breaks off too often, the disk is
    /// full, or `progress` is cancelled. The part that has arrived stays.
    pub fn run(&self) -> Result<Served, WeightsError> {
        let (mut failures, mut before) = (0, self.arrived());
        loop {
            let (reason, pause) = match self.attempt() {
                Ok(served) => return Ok(served),
                Err(Ended::Failed(error)) => return Err(error),
                Err(Ended::Broken { reason, pause }) => (reason, pause),
            };
            let arrived = self.arrived();
            failures = if arrived > before { 1 } else { failures + 1 };
            before = arrived;
            if failures == ATTEMPTS || pause.is_some_and(|pause| pause > MAX_PAUSE) {
                return Err(self.unreached(&reason).into());
            }
            let end = Instant::now()
                + pause.unwrap_or(self.network.pause * 2u32.pow(failures.saturating_sub(1)));
            while Instant::now() < end {
                self.poll()?;
                thread::sleep(POLL.min(end.saturating_duration_since(Instant::now())));
            }
        }
    }

    fn arrived(&self) -> u64 {
        fs::metadata(self.part()).map_or(0, |part| part.len())
    }

    fn poll(&self) -> Result<(), WeightsError> {
        if !self.progress.cancelled() {
            return Ok(());
        }
        let (name, kept) = (self.entry.name, self.kept());
        let message = format!("stopped while fetching {name}; nothing was installed{kept}");
        Err(Refusal::new(Category::Stopped, message).into())
    }

    fn kept(&self) -> &'static str {
        match self.arrived() {
            0 => "",
            _ => ", and what has arrived is kept: the same request continues it",
        }
    }

    fn unreached(&self, reason: &str) -> Refusal {
        let url = self.network.url(&self.entry.origin);
        let (name, kept) = (self.entry.name, self.kept());
        Refusal::new(
            Category::TryAgain,
            format!(
                "cannot download {name} from {url}: {reason}. Is this machine offline, or behind a proxy \
                 (HTTPS_PROXY)? Nothing was installed{kept}"
            ),
        )
    }

    fn unwritable(&self, source: std::io::Error) -> WeightsError {
        WeightsError::write(&self.part())(source)
    }

    /// What has arrived of the same address, and what was said of it.
    fn earlier(&self, url: &str) -> Option<(u64, Served)> {
        let served: Served = read_json(&self.record()).ok()??;
        let arrived = self.arrived();
        let usable = served.url == url && arrived > 0 && served.etag.is_some();
        usable.then_some((arrived, served))
    }

    fn attempt(&self) -> Result<Served, Ended> {
        let url = self.network.url(&self.entry.origin);
        let earlier = self.earlier(&url);
        if let Some((arrived, served)) = &earlier
            && served.bytes == Some(*arrived)
        {
            return Ok(served.clone());
        }
        let resume = earlier
            .as_ref()
            .and_then(|(arrived, served)| Some((*arrived, served.etag.clone()?)));
        let answers = self.network.get(&url, resume);
        let head = match self.next(&answers)? {
            Answer::Head(head) => head,
            Answer::Failed(failure) => return Err(self.ended(failure)),
            Answer::Piece(_) | Answer::End => return Err(broken("the answer is empty")),
        };
        let served = |bytes| Served {
            url: url.clone(),
            etag: head.etag.clone(),
            bytes,
            sha256: head.sha256.clone(),
            commit: head.commit.clone(),
        };
        let (start, served) = match (head.status, head.range, earlier) {
            (200, ..) => (0, served(head.length)),
            (206, Some((start, total)), Some((arrived, earlier)))
                if start == arrived && served(Some(total)) == earlier =>
            {
                (start, earlier)
            }
            // it is another file by now
            (206 | 416, _, Some(_)) => {
                fs::remove_file(self.record()).map_err(|error| self.unwritable(error))?;
                return Err(broken("the file has changed"));
            }
            _ => return Err(self.refused(&head)),
        };
        self.check_size(served.bytes, start)?;
        let mut part = self.open(start, &served)?;
        self.copy(&answers, &mut part, start, served.bytes)?;
        Ok(served)
    }

    /// The next part of the answer; looks meanwhile whether it should stop.
    fn next(&self, answers: &Receiver<Answer>) -> Result<Answer, Ended> {
        loop {
            self.poll()?;
            match answers.recv_timeout(POLL) {
                Ok(answer) => return Ok(answer),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Err(broken("the connection ended")),
            }
        }
    }

    fn ended(&self, failure: Failure) -> Ended {
        match failure.passing {
            true => broken(&failure.reason),
            false => self.unreached(&failure.reason).into(),
        }
    }

    /// The file, with its first `start` bytes.
    fn open(&self, start: u64, served: &Served) -> Result<File, WeightsError> {
        let failed = |error| self.unwritable(error);
        if start > 0 {
            return OpenOptions::new()
                .append(true)
                .open(self.part())
                .map_err(failed);
        }
        // the record last: a part of something else has none
        let _ = fs::remove_file(self.record());
        let part = File::create(self.part()).map_err(failed)?;
        let text = serde_json::to_vec(served).map_err(|error| failed(error.into()))?;
        fs::write(self.record(), text).map_err(failed)?;
        Ok(part)
    }

    fn copy(
        &self,
        answers: &Receiver<Answer>,
        part: &mut File,
        start: u64,
        total: Option<u64>,
    ) -> Result<(), Ended> {
        let (begin, mut bytes) = (Instant::now(), start);
        let phase = format!("MB of {}", self.entry.name);
        let megabytes = |bytes: u64| bytes.div_ceil(1_000_000) as usize;
        let estimate = u64::from(self.entry.megabytes) * 1_000_000;
        loop {
            let per_s = (bytes - start) as f64 / begin.elapsed().as_secs_f64().max(1e-3);
            let note = match bytes == start {
                true => String::new(),
                false => format!("{:.1} MB/s", per_s / 1e6),
            };
            let all = megabytes(total.unwrap_or(estimate).max(bytes));
            self.progress.update(&phase, megabytes(bytes), all, &note);
            match self.next(answers)? {
                Answer::Piece(piece) => {
                    part.write_all(&piece)
                        .map_err(|error| self.unwritable(error))?;
                    bytes += piece.len() as u64;
                    if total
                        .or(self.entry.bytes)
                        .is_some_and(|total| bytes > total)
                    {
                        return Err(self.larger().into());
                    }
                }
                Answer::End if total.is_none_or(|total| total == bytes) => return Ok(()),
                Answer::End => return Err(broken("the connection ended")),
                Answer::Failed(failure) => return Err(self.ended(failure)),
                Answer::Head(_) => return Err(broken("two answers came")),
            }
        }
    }

    /// Refuses a file of another size than the published one before it is downloaded, and one that
    /// the disk has no room for.
    fn check_size(&self, bytes: Option<u64>, start: u64) -> Result<(), WeightsError> {
        let archive = matches!(self.entry.origin, super::Origin::Archive { .. });
        let Some(bytes) = bytes else { return Ok(()) };
        if self.entry.bytes.is_some_and(|expected| bytes > expected) && !archive {
            return Err(self.larger());
        }
        // a member is stored beside its archive
        let member = match archive {
            true => u64::from(self.entry.megabytes) * 1_000_000,
            false => 0,
        };
        let needed = bytes.saturating_sub(start) + member + SPARE_BYTES;
        match (self.network.free_bytes)(self.folder) {
            Some(free) if free < needed => {
                let name = self.entry.name;
                let (needed, free) = (needed.div_ceil(1_000_000), free / 1_000_000);
                let message = format!(
                    "the disk of {} has no room for {name}: {needed} MB are needed, {free} MB are free; free some, or set \
                     MINUTE4D_WEIGHTS to use another folder",
                    self.folder.display()
                );
                Err(Refusal::new(Category::CannotWrite, message).into())
            }
            _ => Ok(()),
        }
    }

    fn larger(&self) -> WeightsError {
        WeightsError::Damaged(format!(
            "{} is larger than what was published as {}; nothing was installed",
            self.network.url(&self.entry.origin),
            self.entry.name
        ))
    }

    fn refused(&self, head: &Head) -> Ended {
        let url = self.network.url(&self.entry.origin);
        let (name, status) = (self.entry.name, head.status);
        match status {
            401 | 403 => Refusal::new(
                Category::NoInput,
                format!(
                    "{url} is not for everyone (HTTP {status}): accept the terms of {name} on the page of the repository, \
                     and set HF_TOKEN to a token of that account"
                ),
            )
            .into(),
            404 | 410 => Refusal::new(
                Category::NoInput,
                format!("{name} is not at {url} any more (HTTP {status}); look for a newer version of this program"),
            )
            .into(),
            408 | 429 | 500..=599 => Ended::Broken {
                reason: match head.retry_after_s {
                    Some(s) => format!("the host is busy (HTTP {status}) and asks to wait {s} s"),
                    None => format!("the host is busy (HTTP {status})"),
                },
                pause: head.retry_after_s.map(Duration::from_secs),
            },
            _ => self
                .unreached(&format!("the host answers with HTTP {status}"))
                .into(),
        }
    }
}

fn broken(reason: &str) -> Ended {
    Ended::Broken {
        reason: reason.to_owned(),
        pause: None,
    }
}
