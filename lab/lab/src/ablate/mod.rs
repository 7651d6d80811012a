//! Ablations on a clip: trains the scene with the full method, and again without one part each
//! (paper, table 3).
//!
//! ```text
//! settings --switch a part off--> `minute4d run`, one process per row --> scene --held-out views--> PSNR, SSIM;  its record --> seconds, memory
//! ```
//!
//! Rows share the geometry, except for the row without segmentation, which has its own. All rows
//! take as many steps as the full one.

mod row;
mod tracking_effect;

pub use row::Row;

use crate::bench::{aligned, number, today};
use m4_core::{Capture, CompactMask};
use m4_geometry::resample::resize_bilinear;
use m4_io::atomic;
use m4_io::capture::Split;
use m4_io::reach::Reach;
use m4_io::results::{Kind, ResultFolder};
use minute4d::json::write_json;
use minute4d::layout::CAPTURE_FOLDER;
use minute4d::layout::is_capture;
use minute4d::observer::check_stop;
use minute4d::{Settings, environment};
use minute4d_cli::run::Job;
use minute4d_cli::run::record::{GeometryRecord, RunRecord, Status};
use minute4d_eval::Error;
use minute4d_eval::{self as evaluate, EvalOptions};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Name of the image of what tracking changes.
const TRACKING_FILE: &str = "tracking.png";
/// Name of the report.
pub const ABLATION_FILE: &str = "ablation.json";
/// Name of the table.
pub const TABLE_FILE: &str = "ablation.md";

/// One row.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RowReport {
    row: Row,
    /// Why it does not apply, where it does not: then everything else is absent.
    skipped: Option<String>,
    /// Mean PSNR of the held-out views, dB.
    psnr_db: Option<f64>,
    /// The same inside the masks of dynamic regions, where there are any.
    moving_psnr_db: Option<f64>,
    /// Mean SSIM of the held-out views.
    ssim: Option<f64>,
    /// The same inside the masks.
    moving_ssim: Option<f64>,
    /// Wall-clock seconds of the geometry that it stands on; absent where the input brought it.
    geometry_s: Option<f64>,
    /// Wall-clock seconds of the first splats and their optimisation.
    train_s: Option<f64>,
    /// Most memory that its process held, bytes; only where the system tells.
    peak_memory_bytes: Option<u64>,
    splats: Option<usize>,
    iterations: Option<usize>,
}

/// `ablation.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AblationReport {
    format: String,
    version: u32,
    minute4d: String,
    date: String,
    /// What the scenes were made of.
    input: PathBuf,
    /// The capture whose held-out views were scored.
    data: PathBuf,
    /// Threads; the scenes do not depend on them.
    threads: usize,
    rows: Vec<RowReport>,
    /// An image of what tracking brings, where both rows are there.
    pub image: Option<PathBuf>,
}

impl AblationReport {
    /// One Markdown row each, with the difference to everything in brackets.
    pub fn to_markdown(&self) -> String {
        let head = [
            "",
            "PSNR dB",
            "SSIM",
            "PSNR dB moving",
            "SSIM moving",
            "splats",
            "geometry s",
            "train s",
            "peak MB",
        ];
        let full = self.rows.iter().find(|row| row.row == Row::Full);
        let number = |row: &RowReport, value: Option<f64>, digits: usize| match row.skipped {
            Some(_) => "n/a".to_owned(),
            None => number(value, digits),
        };
        let with_difference =
            |row: &RowReport, of: &dyn Fn(&RowReport) -> Option<f64>, digits: usize| {
                let value = of(row);
                match (value, full.and_then(of)) {
                    (Some(own_value), Some(full_value)) if row.row != Row::Full => {
                        format!(
                            "{own_value:.digits$} ({:+.digits$})",
                            own_value - full_value
                        )
                    }
                    _ => number(row, value, digits),
                }
            };
        let mut table = vec![head.map(str::to_owned).to_vec()];
        table.extend(self.rows.iter().map(|row| {
            vec![
                row.row.title().to_owned(),
                with_difference(row, &|r| r.psnr_db, 2),
                with_difference(row, &|r| r.ssim, 4),
                with_difference(row, &|r| r.moving_psnr_db, 2),
                with_difference(row, &|r| r.moving_ssim, 4),
                number(row, row.splats.map(|n| n as f64), 0),
                number(row, row.geometry_s, 0),
                number(row, row.train_s, 0),
                number(
                    row,
                    row.peak_memory_bytes.map(|bytes| bytes as f64 / 1e6),
                    0,
                ),
            ]
        }));
        let mut out = aligned(&table);
        for row in &self.rows {
            if let Some(why) = &row.skipped {
                out.push_str(&format!("\n{}: not applicable, {why}\n", row.row.title()));
            }
        }
        out
    }
}

/// What to leave out, and what to score.
#[derive(Debug, Clone)]
pub struct AblateOptions {
    /// This program, which is started for every row, so that each has memory of its own.
    pub program: PathBuf,
    /// Which rows; [`Row::Full`] is added.
    pub rows: Vec<Row>,
    /// The capture with the held-out views; the input itself where it is a capture.
    pub data: Option<PathBuf>,
    /// Masks of dynamic regions are grown by this before they are scored, pixels.
    pub grow_mask: usize,
}

/// Makes every row of the table in a folder of its own in `out`, scores the held-out views, and
/// writes the table and an image of what tracking brings. Rows that are finished are not made
/// again; [`Job::existing`] is of no meaning.
///
/// # Errors
///
/// [`minute4d::Error::Refused`] without held-out views; else [`Error`] of the row that failed, or
/// what cannot be read or written.
pub fn ablate(
    input: &Path,
    out: &Path,
    options: &AblateOptions,
    job: &Job<'_>,
) -> Result<AblationReport, Error> {
    minute4d::Error::unless_exists("video, folder of images or capture", input)?;
    job.check()?;
    let data = options.data.clone().unwrap_or_else(|| input.to_path_buf());
    if !data.join(Split::Test.file_name()).is_file() {
        return Err(evaluate::no_test_list(&data).into());
    }
    let wanted = |row: &Row| *row == Row::Full || options.rows.contains(row);
    let rows: Vec<Row> = Row::ALL.into_iter().filter(wanted).collect();
    let configs: Vec<String> = rows
        .iter()
        .map(|row| format!("{}.toml", row.name()))
        .collect();
    let files = [ABLATION_FILE, TABLE_FILE, TRACKING_FILE]
        .into_iter()
        .chain(configs.iter().map(String::as_str));
    minute4d::layout::claim(out, Kind::Report, &files.collect::<Vec<_>>())?;
    let mut reports = Vec::new();
    let mut settings = job.settings.clone();
    for (i, &row) in rows.iter().enumerate() {
        job.observer.update("rows", i, rows.len(), row.title());
        let bench = Bench {
            input,
            out,
            data: &data,
            options,
            job,
        };
        let report = bench.row(row, &settings)?;
        if let (Row::Full, Some(iterations)) = (row, report.iterations) {
            // the others take as many steps, however fast they are
            (settings.train.iterations, settings.train.budget_s) = (iterations, 0.0);
        }
        reports.push(report);
        job.observer.update("rows", i + 1, rows.len(), row.title());
    }
    let has_row = |row| {
        reports
            .iter()
            .any(|r: &RowReport| r.row == row && r.skipped.is_none())
    };
    let image = if has_row(Row::NoTrack) {
        let folders = [Row::NoTrack, Row::Full].map(|row| out.join(row.name()));
        tracking_effect::write(&folders, &data, &out.join(TRACKING_FILE), job)?
    } else {
        None
    };
    let report = AblationReport {
        format: "minute4d-ablation".to_owned(),
        version: 1,
        minute4d: env!("CARGO_PKG_VERSION").to_owned(),
        date: today(),
        input: input.to_path_buf(),
        data,
        threads: minute4d_cli::run::threads(),
        rows: reports,
        image,
    };
    write_json(&out.join(ABLATION_FILE), &report)?;
    let table = out.join(TABLE_FILE);
    atomic::write(&table, report.to_markdown().as_bytes()).map_err(|source| {
        minute4d::Error::Write {
            path: table,
            source,
        }
    })?;
    Ok(report)
}

struct Bench<'a> {
    input: &'a Path,
    out: &'a Path,
    data: &'a Path,
    options: &'a AblateOptions,
    job: &'a Job<'a>,
}

impl Bench<'_> {
    fn row(&self, row: Row, settings: &Settings) -> Result<RowReport, Error> {
        let skip = |why: &str| RowReport {
            row,
            skipped: Some(why.to_owned()),
            ..RowReport::default()
        };
        let folder = self.out.join(row.name());
        let from_frames = !is_capture(self.input);
        if let Some(why) = row.not_applicable(!from_frames, settings)? {
            return Ok(skip(why));
        }
        let input = match row {
            Row::NoSeg if !from_frames => match self.coarse()? {
                Ok(capture) => capture,
                Err(why) => return Ok(skip(why)),
            },
            // nothing that these rows change is older than the capture
            Row::NoTrack | Row::NoLossGuided | Row::NoDensity if from_frames => {
                self.out.join(Row::Full.name()).join(CAPTURE_FOLDER)
            }
            _ => self.input.to_path_buf(),
        };
        let mut settings = settings.clone();
        if let Some(part) = row.without() {
            settings.switch_off(part);
        }
        settings.viewer.write = false;
        let record = self.run(&input, &folder, row, &settings)?;
        let options = EvalOptions {
            grow_mask: self.options.grow_mask,
            device: self.job.device.choice,
            reach: self.job.settings.capture.reach,
            ..EvalOptions::default()
        };
        let scores = evaluate::views(&folder, self.data, &options, self.job.observer)?;
        let mean = scores.mean;
        let stage = |name: &str| record.stages.get(name).map(|stage| stage.seconds);
        let shared = GeometryRecord::read(&input)?
            .filter(|_| from_frames)
            .map(|record| record.seconds);
        Ok(RowReport {
            row,
            skipped: None,
            psnr_db: mean.map(|mean| mean.psnr_db),
            moving_psnr_db: mean.and_then(|mean| mean.masked_psnr_db),
            ssim: mean.map(|mean| mean.ssim),
            moving_ssim: mean.and_then(|mean| mean.masked_ssim),
            geometry_s: stage(minute4d_cli::run::geometry::STAGE).or(shared),
            train_s: stage(minute4d_cli::run::train::STAGE),
            peak_memory_bytes: record.peak_memory_bytes,
            splats: Some(scores.splats),
            iterations: record.iterations,
        })
    }

    /// The input with masks of pixels that are more likely dynamic than static by its maps,
    /// unrefined; or why it has none.
    fn coarse(&self) -> Result<Result<PathBuf, &'static str>, Error> {
        let folder = self.out.join("coarse");
        let mut capture: Capture = m4_io::capture::read(
            self.input,
            Split::Train,
            &self.job.settings.capture,
            self.job.observer,
        )?;
        if capture.frames.iter().any(|frame| frame.motion.is_none()) {
            return Ok(Err(
                match capture.frames.iter().any(|frame| frame.mask.is_some()) {
                    true => {
                        "the masks of the capture are given, and it has no motion maps to make coarse ones of"
                    }
                    false => "the capture has no masks and no motion maps",
                },
            ));
        }
        if folder.join(Split::Train.file_name()).is_file() {
            return Ok(Ok(folder));
        }
        let tau = m4_geometry::megasam::TAU_MOTION as f32;
        for frame in &mut capture.frames {
            let Some(motion) = &frame.motion else {
                continue;
            };
            let share = motion.map(|&m| f32::from(m) / 255.0);
            let (w, h) = frame.rgb.size();
            let share = resize_bilinear(&share, w, h);
            frame.mask = Some(CompactMask::from_fn(w, h, |x, y| share[(x, y)] > tau));
        }
        let mut results = ResultFolder::open(&folder, Kind::Capture)?;
        results.check_free(minute4d::layout::capture_names())?;
        m4_io::capture::write(&results.begin()?, &capture, Split::Train, self.job.observer)?;
        results.commit(None)?;
        Ok(Ok(folder))
    }

    fn run(
        &self,
        input: &Path,
        folder: &Path,
        row: Row,
        settings: &Settings,
    ) -> Result<RunRecord, Error> {
        let config = self.out.join(format!("{}.toml", row.name()));
        let text = settings.to_toml()?;
        atomic::write(&config, text.as_bytes()).map_err(minute4d::Error::write(&config))?;
        let mut command = Command::new(&self.options.program);
        command
            .args([crate::program::MINUTE4D, "run"])
            .arg(input)
            .arg("-o")
            .arg(folder)
            .arg("--config")
            .arg(&config);
        command.args(["--resume", "--quiet"]);
        command.args(["--threads", &minute4d_cli::run::threads().to_string()]);
        command.args(["--device", &self.job.device.choice.to_string()]);
        if self.job.settings.capture.reach == Reach::Anywhere {
            command.arg("--allow-outside");
        }
        environment::pass_on(&mut command);
        let ended = command.stdin(Stdio::null()).stdout(Stdio::null()).output();
        let ended = ended.map_err(minute4d::Error::read(&self.options.program))?;
        check_stop(self.job.observer, "ablate", true)?;
        if let Some(record) =
            RunRecord::read(folder)?.filter(|record| record.status == Status::Finished)
            && ended.status.success()
        {
            return Ok(record);
        }
        let (name, place, said) = (
            row.name(),
            folder.display(),
            String::from_utf8_lossy(&ended.stderr),
        );
        Err(minute4d::Refusal::bad_input(format!(
            "the row {name} failed: {}; its files are in {place}",
            said.trim()
        ))
        .into())
    }
}

#[cfg(test)]
mod tests {
    use super::{AblationReport, Row, RowReport};

    #[test]
    fn differences_are_to_the_full_row() {
        let row = |row, psnr| RowReport {
            row,
            psnr_db: Some(psnr),
            ..RowReport::default()
        };
        let skipped = Some("there is nothing to segment".to_owned());
        let report = AblationReport {
            format: String::new(),
            version: 1,
            minute4d: String::new(),
            date: String::new(),
            input: "clip".into(),
            data: "clip".into(),
            threads: 2,
            rows: vec![
                row(Row::Full, 25.0),
                row(Row::NoTrack, 24.25),
                RowReport {
                    row: Row::NoSeg,
                    skipped,
                    ..RowReport::default()
                },
            ],
            image: None,
        };
        let text = report.to_markdown();
        assert!(
            text.contains("24.25 (-0.75)") && text.contains("25.00") && text.contains("n/a"),
            "{text}"
        );
        assert!(
            text.contains("without segmentation: not applicable, there is nothing to segment"),
            "{text}"
        );
    }
}
