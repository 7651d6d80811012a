//! What came of a batch, read from the results alone.

mod page;

pub use page::sheet;

use crate::error::FileError;
use crate::layout::{Layout, RUN_FILE};
use crate::lease;
use crate::manifest::{Job, Manifest};
use crate::publish::{Present, present};
use crate::record::{JobRecord, Verdict, read_json};
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::Duration;

/// How far a clip is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ClipState {
    /// Its result is published.
    Done,
    /// A worker has it.
    Running,
    /// A worker had it and vanished.
    Stale,
    /// Nobody has begun it.
    Waiting,
    /// It was given up.
    Poison,
    /// It crashed, and nobody has it.
    Failed,
    /// It was stopped, and nobody has it.
    Interrupted,
}

impl ClipState {
    /// All of them, in the order of a summary.
    pub const ALL: [Self; 7] = [
        Self::Done,
        Self::Running,
        Self::Stale,
        Self::Waiting,
        Self::Poison,
        Self::Failed,
        Self::Interrupted,
    ];

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Running => "running",
            Self::Stale => "stale",
            Self::Waiting => "waiting",
            Self::Poison => "poison",
            Self::Failed => "failed",
            Self::Interrupted => "interrupted",
        }
    }

    /// True for what somebody should look at.
    #[must_use]
    pub fn is_trouble(self) -> bool {
        matches!(self, Self::Stale | Self::Poison | Self::Failed | Self::Interrupted)
    }
}

/// One clip.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClipReport {
    /// The job.
    pub id: String,
    /// The clip.
    pub input: String,
    /// How far it is.
    pub state: ClipState,
    /// Why it is not further, where something is known.
    pub reason: Option<String>,
    /// Exit code of its last run.
    pub code: Option<i32>,
    /// Wall-clock seconds of all stages.
    pub seconds: Option<f64>,
    /// Splats of its scene.
    pub splats: Option<u64>,
    /// PSNR of the training pictures at the end, dB.
    pub psnr_db: Option<f64>,
    /// Most memory that its run held, bytes.
    pub peak_memory_bytes: Option<u64>,
    /// Where it is or was last worked at.
    pub host: Option<String>,
    /// Attempts that crashed.
    pub attempts: u32,
    /// Its result.
    pub output: String,
}

/// A whole batch.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// How many clips there are.
    pub jobs: usize,
    /// How many are in each state; they add up to `jobs`.
    pub counts: BTreeMap<&'static str, usize>,
    /// Wall-clock seconds of all that is done.
    pub seconds: f64,
    /// What troubles are about, with the clips that have them.
    pub reasons: BTreeMap<String, Vec<String>>,
    /// The clips, as the manifest lists them.
    pub clips: Vec<ClipReport>,
}

impl Report {
    /// Reads how far every clip is. A lease that has not been renewed for `lasts` counts as stale.
    ///
    /// # Errors
    ///
    /// [`FileError`] for what is there and cannot be read.
    pub fn read(manifest: &Manifest, lasts: Duration) -> Result<Self, FileError> {
        let layout = Layout::new(Path::new(&manifest.results), None);
        let mut clips = Vec::with_capacity(manifest.jobs.len());
        for job in &manifest.jobs {
            clips.push(clip(&layout, job, &job.key(&manifest.run), lasts)?);
        }
        Ok(Self::of(clips))
    }

    fn of(clips: Vec<ClipReport>) -> Self {
        let mut counts: BTreeMap<_, _> = ClipState::ALL.map(|state| (state.name(), 0)).into();
        let mut reasons: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for clip in &clips {
            *counts.entry(clip.state.name()).or_default() += 1;
            if clip.state.is_trouble() {
                // The same trouble of two clips differs by their names.
                let reason = clip.reason.clone().unwrap_or_default();
                let reason = reason.replace(&clip.input, "INPUT").replace(&clip.output, "OUTPUT");
                let about = format!("{}: {}", clip.state.name(), reason.replace(&clip.id, "ID"));
                reasons.entry(about).or_default().push(clip.id.clone());
            }
        }
        Self {
            jobs: clips.len(),
            counts,
            seconds: clips
                .iter()
                .filter(|c| c.state == ClipState::Done)
                .filter_map(|c| c.seconds)
                .sum(),
            reasons,
            clips,
        }
    }

    /// The table, for people: a line a clip, then the sums, then the troubles by reason; `failed` for troubles alone.
    #[must_use]
    pub fn table(&self, failed: bool) -> String {
        let width = self.clips.iter().map(|c| c.id.len()).max().unwrap_or(0).clamp(4, 40);
        let mut text = format!(
            "{:<width$}  {:<11} {:>8} {:>9} {:>8} {:>8}  host\n",
            "clip", "state", "seconds", "splats", "PSNR dB", "peak MB"
        );
        for clip in self.clips.iter().filter(|c| !failed || c.state.is_trouble()) {
            let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
            text += &format!(
                "{:<width$}  {:<11} {:>8} {:>9} {:>8} {:>8}  {}\n",
                clip.id,
                clip.state.name(),
                or_dash(clip.seconds.map(|s| format!("{s:.1}"))),
                or_dash(clip.splats.map(|n| n.to_string())),
                or_dash(clip.psnr_db.map(|p| format!("{p:.2}"))),
                or_dash(clip.peak_memory_bytes.map(|b| (b / 1_000_000).to_string())),
                or_dash(clip.host.clone()),
            );
        }
        let counts = ClipState::ALL
            .iter()
            .map(|s| (s.name(), self.counts.get(s.name()).copied().unwrap_or(0)));
        let counts: Vec<String> = counts
            .filter(|(_, n)| *n > 0)
            .map(|(name, n)| format!("{n} {name}"))
            .collect();
        text += &format!("\n{} clips: {}\n", self.jobs, counts.join(", "));
        for (reason, ids) in &self.reasons {
            text += &format!("{} x {reason}\n    {}\n", ids.len(), ids.join(" "));
        }
        text
    }
}

fn clip(layout: &Layout, job: &Job, key: &str, lasts: Duration) -> Result<ClipReport, FileError> {
    let record = JobRecord::read(&layout.state(&job.id), key)?;
    let result = layout.result(&job.id);
    let lease = lease::look(&layout.leases(&job.id))?;
    let holder = lease.as_ref().and_then(|l| l.holder.clone());
    let here = present(&result, key)?;
    let state = match (&here, &lease, record.as_ref().map(|r| r.verdict)) {
        (Present::Same, ..) => ClipState::Done,
        (_, Some(lease), _) if lease.is_alive(lasts) => ClipState::Running,
        (_, Some(lease), _) if !lease.is_released() => ClipState::Stale,
        (_, _, Some(Verdict::Poison)) => ClipState::Poison,
        (_, _, Some(Verdict::Failed)) => ClipState::Failed,
        (_, _, Some(Verdict::Interrupted)) => ClipState::Interrupted,
        // Published once, and not whole any more.
        (_, _, Some(Verdict::Done)) | (_, _, None) => ClipState::Waiting,
    };
    let reason = match state {
        ClipState::Done | ClipState::Running => None,
        ClipState::Stale => Some("its worker vanished".to_owned()),
        _ if here == Present::Foreign => Some("a folder that is no result of a batch is in its place".to_owned()),
        ClipState::Waiting if here == Present::Other => Some("its result is of other settings, or damaged".to_owned()),
        _ => record.as_ref().map(|r| r.reason.clone()),
    };
    let at_work = matches!(state, ClipState::Running | ClipState::Stale);
    let mut clip = ClipReport {
        id: job.id.clone(),
        input: job.input.clone(),
        state,
        reason,
        code: record.as_ref().and_then(|r| r.code),
        seconds: None,
        splats: None,
        psnr_db: None,
        peak_memory_bytes: None,
        host: holder
            .filter(|_| at_work)
            .map(|h| h.host)
            .or(record.as_ref().map(|r| r.host.clone())),
        attempts: record.as_ref().map_or(0, |r| r.attempts),
        output: job.output.clone(),
    };
    if state == ClipState::Done {
        if let Some(run) = read_json::<Value>(&result.join(RUN_FILE))? {
            clip.seconds = run["seconds"].as_f64();
            clip.peak_memory_bytes = run["peak_memory_bytes"].as_u64();
            let count = |kind: &str| run["splats"][kind].as_u64();
            clip.splats = count("static").zip(count("dynamic")).map(|(a, b)| a + b);
        }
        clip.psnr_db = last_psnr(&result.join("metrics.jsonl"));
    } else {
        clip.seconds = record.map(|r| r.seconds);
    }
    Ok(clip)
}

/// PSNR of the last event of training, dB.
fn last_psnr(path: &Path) -> Option<f64> {
    let text = fs::read_to_string(path).ok()?;
    let last = text.lines().rfind(|l| !l.trim().is_empty())?;
    serde_json::from_str::<Value>(last).ok()?["psnr"].as_f64()
}

#[cfg(test)]
mod tests;
