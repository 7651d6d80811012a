//! Peak memory of training: the program trains on a synthetic clip, and the peak is read from its record.

use super::Machine;
use super::table::{self, aligned, today};
use crate::record::RunRecord;
use crate::stage::check_stop;
use crate::{Error, Observer};
use m4_core::Silent;
use m4_io::capture::Split;
use m4_kernels::SimdLevel;
use m4_kernels::bench::film;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// What to train on.
#[derive(Debug, Clone, PartialEq)]
pub struct MemoryConfig {
    /// Frames of the clips, one run each.
    pub frames: Vec<usize>,
    /// Columns and rows of the frames.
    pub size: (usize, usize),
    /// Splats to start with, about, a third of them static.
    pub splats: usize,
    /// Name of the processor, for the report.
    pub cpu: Option<String>,
}

impl Default for MemoryConfig {
    /// 96 and 400 frames of 480x360, 100,000 splats.
    fn default() -> Self {
        Self { frames: vec![96, 400], size: (480, 360), splats: 100_000, cpu: None }
    }
}

/// One run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MemoryCase {
    frames: usize,
    width: usize,
    height: usize,
    /// Static splats at the end.
    splats_static: usize,
    /// Dynamic splats at the end.
    splats_dynamic: usize,
    iterations: usize,
    /// Most memory that the process held (resident set), bytes: reading, initialisation, training,
    /// checkpoints, writing the scene and the preview. None where the system does not tell.
    peak_bytes: Option<u64>,
    /// Images, depth and masks in memory, bytes: part of the above.
    capture_bytes: u64,
    /// Size of the finished scene file, bytes.
    scene_bytes: u64,
    /// Seconds of initialisation and training.
    seconds: f64,
}

/// What `minute4d bench --memory` measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MemoryReport {
    format: String,
    version: u32,
    date: String,
    machine: Machine,
    cases: Vec<MemoryCase>,
}

/// Trains `program` (the executable of minute4d) on each clip in a process of its own.
///
/// # Errors
///
/// [`Error`] if a clip cannot be written to the folder for temporary files, the program cannot be started
/// or fails, or on request.
pub fn memory(program: &Path, config: &MemoryConfig, observer: &dyn Observer) -> Result<MemoryReport, Error> {
    let level = SimdLevel::detect()?;
    let mut cases = Vec::new();
    for (i, &frames) in config.frames.iter().enumerate() {
        observer.update("bench", i, config.frames.len(), &format!("{frames} frames"));
        check_stop(observer, "bench", false)?;
        cases.push(case(program, config, frames)?);
        observer.update("bench", i + 1, config.frames.len(), &format!("{frames} frames"));
    }
    Ok(MemoryReport {
        format: "minute4d-bench-memory".to_owned(),
        version: 1,
        date: today(),
        machine: Machine::here(level, config.cpu.clone()),
        cases,
    })
}

fn case(program: &Path, config: &MemoryConfig, frames: usize) -> Result<MemoryCase, Error> {
    let work = tempfile::tempdir().map_err(|source| Error::Write { path: std::env::temp_dir(), source })?;
    let (clip, out) = (work.path().join("clip"), work.path().join("out"));
    let (width, height) = config.size;
    m4_io::capture::write(&clip, &film(frames, width, height), Split::Train, &Silent)?;
    // so that every frame was seen at full size
    let iterations = 2 * frames + 100;
    let n_static = config.splats / 3;
    let settings = [
        "checkpoint.every_s=5".to_owned(),
        format!("init.max_static={n_static}"),
        format!("init.max_dynamic={}", config.splats - n_static),
    ];
    let mut command = Command::new(program);
    command.arg("train").arg(&clip).arg("-o").arg(&out).arg("--quiet");
    command.args(["--iterations", &iterations.to_string()]);
    command.args(["--threads", &rayon::current_num_threads().to_string()]);
    for setting in &settings {
        command.args(["--set", setting]);
    }
    let ended = command.stdin(Stdio::null()).stdout(Stdio::null()).output();
    let ended = ended.map_err(|source| Error::Read { path: program.to_path_buf(), source })?;
    if !ended.status.success() {
        return Err(Error::Internal {
            what: format!(
                "training on {frames} made-up frames failed: {}",
                String::from_utf8_lossy(&ended.stderr).trim()
            ),
        });
    }
    let record =
        RunRecord::read(&out)?.ok_or_else(|| Error::Missing { what: "record of the run", path: out.clone() })?;
    let (splats_static, splats_dynamic) = record.splats.map_or((0, 0), |s| (s.r#static, s.dynamic));
    Ok(MemoryCase {
        frames,
        width,
        height,
        splats_static,
        splats_dynamic,
        iterations,
        peak_bytes: record.peak_memory_bytes,
        // colour, depth in steps of 16 bits, a bit of mask
        capture_bytes: (frames * (width * height * (3 + 2) + (width * height).div_ceil(64) * 8)) as u64,
        scene_bytes: record.files.get(crate::folder::SCENE_FILE).map_or(0, |f| f.bytes),
        seconds: record.stages.get(crate::train::STAGE).map_or(0.0, |s| s.seconds),
    })
}

impl MemoryReport {
    /// Writes the report as JSON and as Markdown into `folder`; returns the path of the JSON file.
    ///
    /// # Errors
    ///
    /// [`Error::Write`].
    pub fn save(&self, folder: &Path) -> Result<PathBuf, Error> {
        table::save(folder, (&self.date, "-memory"), &self.machine, self, &self.to_markdown())
    }

    /// One row per clip.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let head = ["frames", "size", "splats", "steps", "peak MB", "of it images MB", "scene file MB", "train s"];
        let mb = |bytes: u64| format!("{:.0}", bytes as f64 / 1e6);
        let mut rows = vec![head.map(str::to_owned).to_vec()];
        rows.extend(self.cases.iter().map(|c| {
            vec![
                c.frames.to_string(),
                format!("{}x{}", c.width, c.height),
                format!("{} + {}", c.splats_static, c.splats_dynamic),
                c.iterations.to_string(),
                c.peak_bytes.map_or_else(|| "unknown".to_owned(), mb),
                mb(c.capture_bytes),
                mb(c.scene_bytes),
                format!("{:.0}", c.seconds),
            ]
        }));
        format!("# Memory of training, {}\n\n{}\n\n{}", self.date, self.machine.line(), aligned(&rows))
    }
}
