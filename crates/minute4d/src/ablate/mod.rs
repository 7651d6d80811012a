//! Ablations on a clip: trains the scene with the full method, and again without one part each (paper, table 3).
//!
//! ```text
//! settings --switch a part off--> `minute4d run`, one process per row --> scene --held-out views--> PSNR, SSIM;  its record --> seconds, memory
//! ```
//!
//! Rows share the geometry, except for the row without segmentation, which has its own. All rows take as many steps as the full one.

mod report;
mod tracking_effect;

pub use report::{AblationReport, Row, RowReport, UnknownRow};

use crate::bench::today;
use crate::evaluate::{self, EvalOptions, EvalReport};
use crate::folder::CAPTURE_FOLDER;
use crate::record::{GeometryRecord, RunRecord, Status, write_json};
use crate::{Error, Job, Settings, is_capture};
use m4_core::{Capture, CompactMask};
use m4_geometry::resample::resize_bilinear;
use m4_io::atomic;
use m4_io::capture::Split;
use m4_io::reach::Reach;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Name of the report.
pub const ABLATION_FILE: &str = "ablation.json";
/// Name of the table.
pub const TABLE_FILE: &str = "ablation.md";

/// What to leave out, and what to score.
#[derive(Debug, Clone)]
pub struct AblateOptions {
    /// The program itself, which is started for every row, so that each has memory of its own.
    pub program: PathBuf,
    /// Which rows; [`Row::Full`] is added.
    pub rows: Vec<Row>,
    /// The capture with the held-out views; the input itself where it is a capture.
    pub data: Option<PathBuf>,
    /// Masks of dynamic regions are grown by this before they are scored, pixels.
    pub grow_mask: usize,
}

/// Makes every row of the table in a folder of its own in `out`, scores the held-out views, and writes the table and an image of what
/// tracking brings. Rows that are finished are not made again; [`Job::existing`] is of no meaning.
///
/// # Errors
///
/// [`Error::Refused`] without held-out views; else [`Error`] of the row that failed, or what cannot be read or written.
pub fn ablate(input: &Path, out: &Path, options: &AblateOptions, job: &Job<'_>) -> Result<AblationReport, Error> {
    if !input.exists() {
        return Err(Error::Missing { what: "video, folder of images or capture", path: input.to_path_buf() });
    }
    job.check()?;
    let data = options.data.clone().unwrap_or_else(|| input.to_path_buf());
    if !data.join(Split::Test.file_name()).is_file() {
        return Err(evaluate::no_test_list(&data).into());
    }
    fs::create_dir_all(out).map_err(|source| Error::Write { path: out.to_path_buf(), source })?;
    let wanted = |row: &Row| *row == Row::Full || options.rows.contains(row);
    let rows: Vec<Row> = Row::ALL.into_iter().filter(wanted).collect();
    let mut made = Vec::new();
    let mut settings = job.settings.clone();
    for (i, &row) in rows.iter().enumerate() {
        job.observer.update("rows", i, rows.len(), row.title());
        let bench = Bench { input, out, data: &data, options, job };
        let report = bench.row(row, &settings)?;
        if let (Row::Full, Some(iterations)) = (row, report.iterations) {
            // the others take as many steps, however fast they are
            (settings.train.iterations, settings.train.budget_s) = (iterations, 0.0);
        }
        made.push(report);
        job.observer.update("rows", i + 1, rows.len(), row.title());
    }
    let there = |row| made.iter().any(|r: &RowReport| r.row == row && r.skipped.is_none());
    let image = if there(Row::NoTrack) {
        let folders = [Row::NoTrack, Row::Full].map(|row| out.join(row.name()));
        tracking_effect::write(&folders, &data, &out.join("tracking.png"), job)?
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
        threads: crate::threads(),
        rows: made,
        image,
    };
    write_json(&out.join(ABLATION_FILE), &report)?;
    let table = out.join(TABLE_FILE);
    atomic::write(&table, report.to_markdown().as_bytes()).map_err(|source| Error::Write { path: table, source })?;
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
        let folder = self.out.join(row.name());
        let from_frames = !is_capture(self.input);
        let input = match row {
            Row::NoSeg if !from_frames => match self.coarse()? {
                Some(capture) => capture,
                None => {
                    let why = "the capture has masks but no motion map";
                    return Ok(RowReport::skipped(row, why.to_owned()));
                }
            },
            // nothing that these rows change is older than the capture
            Row::NoTrack | Row::NoDensity if from_frames => self.out.join(Row::Full.name()).join(CAPTURE_FOLDER),
            _ => self.input.to_path_buf(),
        };
        let mut settings = settings.clone();
        if let Some(part) = row.without() {
            settings.switch_off(part);
        }
        self.run(&input, &folder, row, &settings)?;
        let record = RunRecord::read(&folder)?
            .ok_or_else(|| Error::Missing { what: "record of the run", path: folder.clone() })?;
        let scores = self.scores(&folder)?;
        let mean = scores.mean;
        let stage = |name: &str| record.stages.get(name).map(|stage| stage.seconds);
        let shared = GeometryRecord::read(&input)?.filter(|_| from_frames).map(|record| record.seconds);
        Ok(RowReport {
            row,
            skipped: None,
            psnr_db: mean.map(|mean| mean.psnr_db),
            moving_psnr_db: mean.and_then(|mean| mean.masked_psnr_db),
            ssim: mean.map(|mean| mean.ssim),
            moving_ssim: mean.and_then(|mean| mean.masked_ssim),
            geometry_s: stage(crate::geometry::STAGE).or(shared),
            train_s: stage(crate::train::STAGE),
            peak_memory_bytes: record.peak_memory_bytes,
            splats: Some(scores.splats),
            iterations: record.iterations,
        })
    }

    /// The input with masks of pixels that are more likely dynamic than static by its maps, unrefined; `None` where it has no maps.
    fn coarse(&self) -> Result<Option<PathBuf>, Error> {
        let folder = self.out.join("coarse");
        let mut capture: Capture = crate::train::read(self.input, &self.job.settings, self.job.observer)?;
        if capture.frames.iter().any(|frame| frame.motion.is_none()) {
            return Ok(None);
        }
        if folder.join(Split::Train.file_name()).is_file() {
            return Ok(Some(folder));
        }
        let tau = m4_geometry::megasam::TAU_MOTION as f32;
        for frame in &mut capture.frames {
            let Some(motion) = &frame.motion else { continue };
            let share = motion.map(|&m| f32::from(m) / 255.0);
            let (w, h) = frame.rgb.size();
            let share = resize_bilinear(&share, w, h);
            frame.mask = Some(CompactMask::from_fn(w, h, |x, y| share[(x, y)] > tau));
        }
        m4_io::capture::write(&folder, &capture, Split::Train, self.job.observer)?;
        Ok(Some(folder))
    }

    fn run(&self, input: &Path, folder: &Path, row: Row, settings: &Settings) -> Result<(), Error> {
        let mut settings = settings.clone();
        // they are not needed
        settings.viewer.write = false;
        let config = self.out.join(format!("{}.toml", row.name()));
        let text = settings.to_toml()?;
        atomic::write(&config, text.as_bytes()).map_err(|source| Error::Write { path: config.clone(), source })?;
        let mut command = Command::new(&self.options.program);
        command.arg("run").arg(input).arg("-o").arg(folder).arg("--config").arg(&config);
        command.args(["--resume", "--quiet"]);
        command.args(["--threads", &crate::threads().to_string()]);
        command.args(["--device", &self.job.device.choice.to_string()]);
        if self.job.settings.capture.reach == Reach::Anywhere {
            command.arg("--allow-outside");
        }
        let ended = command.stdin(Stdio::null()).stdout(Stdio::null()).output();
        let ended = ended.map_err(|source| Error::Read { path: self.options.program.clone(), source })?;
        if self.job.observer.cancelled() {
            return Err(Error::Stopped { stage: "ablate", saved: true });
        }
        let finished = RunRecord::read(folder)?.is_some_and(|record| record.status == Status::Finished);
        if ended.status.success() && finished {
            return Ok(());
        }
        Err(Error::Row {
            row: row.name(),
            folder: folder.to_path_buf(),
            message: String::from_utf8_lossy(&ended.stderr).trim().to_owned(),
        })
    }

    fn scores(&self, folder: &Path) -> Result<EvalReport, Error> {
        let options = EvalOptions {
            grow_mask: self.options.grow_mask,
            device: self.job.device.choice,
            reach: self.job.settings.capture.reach,
            ..EvalOptions::default()
        };
        evaluate::views_by(folder, self.data, &options, self.job.observer)
    }
}
