//! The report of a batch, read from the results alone.

use crate::batch::layout::{JobRecord, Layout, Outcome};
use crate::batch::manifest::{Job, Manifest};
use crate::batch::publish::{Present, present};
use crate::run::record::RUN_FILE;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use m4_io::files;
use m4_viewer::html::{escape, fill};
use minute4d::Error;
use minute4d::json::{MAX_RECORD_BYTES, read_json};
use minute4d::layout::POSTER_FILE;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// The state of a clip.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ClipState {
    /// Its result is published.
    Done,
    /// Nothing came of it yet; a scheduler knows whether it is at work.
    Waiting,
    /// Its last attempt ended without a result, and the next one may have one.
    Retryable,
    /// A permanent failure.
    Failed,
}

impl ClipState {
    /// All of them, in the order of a summary.
    pub const ALL: [Self; 4] = [Self::Done, Self::Waiting, Self::Retryable, Self::Failed];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Waiting => "waiting",
            Self::Retryable => "retryable",
            Self::Failed => "failed",
        }
    }

    /// Returns true for jobs that need attention.
    pub fn is_trouble(self) -> bool {
        matches!(self, Self::Retryable | Self::Failed)
    }
}

/// One clip.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClipReport {
    /// The job.
    pub id: String,
    /// The clip.
    pub input: String,
    /// The state.
    pub state: ClipState,
    /// Why it is not further, where something is known.
    pub reason: Option<String>,
    /// Exit code of its last run.
    pub code: Option<i32>,
    /// Wall-clock seconds of all stages.
    pub seconds: Option<f64>,
    /// Splats of its scene.
    pub splats: Option<u64>,
    /// PSNR of the training images at the end, dB.
    pub psnr_db: Option<f64>,
    /// Most memory that its run held, bytes.
    pub peak_memory_bytes: Option<u64>,
    /// The machine of its last attempt.
    pub host: Option<String>,
    /// Its result.
    pub output: String,
}

/// A whole batch.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// The number of clips.
    pub jobs: usize,
    /// How many are in each state; they add up to `jobs`.
    pub counts: BTreeMap<&'static str, usize>,
    /// Wall-clock seconds of all that is done.
    pub seconds: f64,
    /// The clips, as the manifest lists them.
    pub clips: Vec<ClipReport>,
}

impl Report {
    /// Reads how far every clip is.
    pub fn read(manifest: &Manifest) -> Result<Self, Error> {
        let layout = Layout::new(Path::new(&manifest.results));
        let mut clips = Vec::with_capacity(manifest.jobs.len());
        for job in &manifest.jobs {
            clips.push(clip(&layout, job, &job.key(&manifest.run))?);
        }
        Ok(Self::of(clips))
    }

    fn of(clips: Vec<ClipReport>) -> Self {
        let mut counts: BTreeMap<_, _> = ClipState::ALL.map(|state| (state.name(), 0)).into();
        for clip in &clips {
            *counts.entry(clip.state.name()).or_default() += 1;
        }
        Self {
            jobs: clips.len(),
            counts,
            seconds: clips
                .iter()
                .filter(|c| c.state == ClipState::Done)
                .filter_map(|c| c.seconds)
                .sum(),
            clips,
        }
    }

    /// The table, for people: a line per clip, then the sums; `failed` for troubles alone.
    pub fn table(&self, failed: bool) -> String {
        let width = self
            .clips
            .iter()
            .map(|c| c.id.len())
            .max()
            .unwrap_or(0)
            .clamp(4, 40);
        let mut text = format!(
            "{:<width$}  {:<9} {:>8} {:>9} {:>8} {:>8}  host, reason\n",
            "clip", "state", "seconds", "splats", "PSNR dB", "peak MB"
        );
        for clip in self
            .clips
            .iter()
            .filter(|c| !failed || c.state.is_trouble())
        {
            let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
            text += &format!(
                "{:<width$}  {:<9} {:>8} {:>9} {:>8} {:>8}  {}\n",
                clip.id,
                clip.state.name(),
                or_dash(clip.seconds.map(|s| format!("{s:.1}"))),
                or_dash(clip.splats.map(|n| n.to_string())),
                or_dash(clip.psnr_db.map(|p| format!("{p:.2}"))),
                or_dash(clip.peak_memory_bytes.map(|b| (b / 1_000_000).to_string())),
                [&clip.host, &clip.reason]
                    .map(|text| text.as_deref().unwrap_or("-").replace('\n', " "))
                    .join("  "),
            );
        }
        text += &format!("\n{}\n", self.sums());
        text
    }

    fn sums(&self) -> String {
        let counts =
            ClipState::ALL.map(|s| (s.name(), self.counts.get(s.name()).copied().unwrap_or(0)));
        let counts = counts.iter().filter(|(_, n)| *n > 0);
        let counts: Vec<String> = counts.map(|(name, n)| format!("{n} {name}")).collect();
        format!("{} clips: {}", self.jobs, counts.join(", "))
    }
}

fn clip(layout: &Layout, job: &Job, key: &str) -> Result<ClipReport, Error> {
    let record = JobRecord::read(&layout.state(&job.id), key)?;
    let result = layout.result(&job.id);
    let here = present(&result, key)?;
    let state = match (&here, record.as_ref().map(|r| r.outcome)) {
        (Present::Same, _) => ClipState::Done,
        (_, Some(Outcome::Failed)) => ClipState::Failed,
        (_, Some(Outcome::Retryable)) => ClipState::Retryable,
        // Published once, and not whole any more.
        (_, Some(Outcome::Done) | None) => ClipState::Waiting,
    };
    let reason = match (state, &here) {
        (ClipState::Done, _) => None,
        (_, Present::NotOurs) => {
            Some("its folder exists and is not a result of `minute4d batch`".to_owned())
        }
        (ClipState::Waiting, Present::Other) => {
            Some("its result is of other settings, or damaged".to_owned())
        }
        _ => record.as_ref().map(|r| r.reason.clone()),
    };
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
        host: record.as_ref().map(|r| r.host.clone()),
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

fn last_psnr(path: &Path) -> Option<f64> {
    let text = files::read_text(path, MAX_RECORD_BYTES).ok()?;
    let last = text.lines().rfind(|l| !l.trim().is_empty())?;
    serde_json::from_str::<Value>(last).ok()?["psnr"].as_f64()
}

/// Largest poster that is put into the page, bytes.
const LARGEST: u64 = 1 << 20;

/// The page. It loads nothing from anywhere; posters are read from the results and put into it.
pub fn page(report: &Report, title: &str) -> String {
    fill(include_str!("page.html"), |name| match name {
        "title" => escape(title),
        "counts" => escape(&report.sums()),
        "clips" => report.clips.iter().map(card).collect(),
        _ => String::new(),
    })
}

fn card(clip: &ClipReport) -> String {
    let state = clip.state.name();
    let rows = [
        ("PSNR", clip.psnr_db.map(|p| format!("{p:.2} dB"))),
        ("splats", clip.splats.map(|n| n.to_string())),
        ("time", clip.seconds.map(|s| format!("{s:.1} s"))),
        (
            "memory",
            clip.peak_memory_bytes
                .map(|b| format!("{} MB", b / 1_000_000)),
        ),
        ("machine", clip.host.clone()),
        ("reason", clip.reason.clone()),
        ("input", Some(clip.input.clone())),
    ];
    let row = |(name, value): (&str, Option<String>)| {
        Some(format!("<dt>{name}</dt><dd>{}</dd>", escape(&value?)))
    };
    fill(include_str!("clip.html"), |name| match name {
        "image" => poster(clip).unwrap_or_else(|| format!("<div class=\"none\">{state}</div>")),
        "id" => escape(&clip.id),
        "state" => state.to_owned(),
        "rows" => rows.clone().into_iter().filter_map(row).collect(),
        _ => String::new(),
    })
}

fn poster(clip: &ClipReport) -> Option<String> {
    let path = Path::new(&clip.output).join(POSTER_FILE);
    let done = clip.state == ClipState::Done;
    let bytes = done.then(|| files::read(&path, LARGEST).ok()).flatten()?;
    let alt = escape(&format!("a frame of {} and its re-render", clip.id));
    Some(format!(
        "<img alt=\"{alt}\" src=\"data:image/jpeg;base64,{}\">",
        STANDARD.encode(bytes)
    ))
}

#[cfg(test)]
mod tests {
    use super::{ClipReport, ClipState, Report, page};
    use std::fs;

    fn clip(id: &str, state: ClipState, reason: Option<&str>, output: &str) -> ClipReport {
        ClipReport {
            id: id.to_owned(),
            input: format!("/clips/{id}.mp4"),
            state,
            reason: reason.map(str::to_owned),
            code: None,
            seconds: Some(2.5),
            splats: Some(10),
            psnr_db: Some(30.123),
            peak_memory_bytes: Some(5_000_000),
            host: Some("h<1>".to_owned()),
            output: output.to_owned(),
        }
    }

    #[test]
    fn status_counts_add_up_and_failures_have_reasons() {
        let clips = vec![
            clip("a", ClipState::Done, None, "/r/a"),
            clip(
                "b7",
                ClipState::Failed,
                Some("/clips/b7.mp4 is empty"),
                "/r/b7",
            ),
            clip(
                "c9",
                ClipState::Failed,
                Some("/clips/c9.mp4 is empty"),
                "/r/c9",
            ),
            clip("d", ClipState::Waiting, None, "/r/d"),
        ];
        let report = Report::of(clips);
        assert_eq!(report.counts.values().sum::<usize>(), report.jobs);
        assert_eq!(report.seconds, 2.5);
        let table = report.table(false);
        assert!(
            table.contains("4 clips: 1 done, 1 waiting, 2 failed")
                && table.contains("30.12")
                && table.contains("b7.mp4 is empty"),
            "{table}"
        );
        let troubles = report.table(true);
        assert!(
            troubles.lines().any(|l| l.starts_with("b7"))
                && !troubles.lines().any(|l| l.starts_with("a "))
        );
    }

    #[test]
    fn the_page_holds_everything_and_escapes_it() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("poster.jpg"), [0xff, 0xd8, 0xff]).unwrap();
        let output = dir.path().to_str().unwrap();
        let clips = vec![
            clip("a", ClipState::Done, None, output),
            clip(
                "b",
                ClipState::Failed,
                Some("<script>alert('{{id}}')</script>"),
                output,
            ),
        ];
        let page = page(&Report::of(clips), "my \"clips\" {{clips}}");
        assert_eq!(page.matches("data:image/jpeg;base64,/9j/").count(), 1);
        assert!(
            !page.contains("<script") && page.contains("&lt;script&gt;alert(&#39;{{id}}&#39;)"),
            "{page}"
        );
        assert!(
            page.contains("my &quot;clips&quot; {{clips}}")
                && page.contains("h&lt;1&gt;")
                && page.contains("30.12 dB")
        );
        assert!(!page.contains("http"), "it loads nothing");
    }
}
