//! `minute4d batch`: processes many clips as jobs of a scheduler.

mod plan;
mod run;

use super::program;
use crate::cli::Common;
use crate::failure::{Failure, chain};
use crate::output::Output;
use clap::{Args, Subcommand};
use minute4d::batch::slurm::{Script, largest_array, submit};
use minute4d::batch::{BatchError, Manifest, Report, page};
use minute4d::io::atomic;
use minute4d::{Category, Error};
use serde_json::json;
use std::path::{Path, PathBuf};

/// `minute4d batch`
#[derive(Debug, Args)]
pub struct Batch {
    /// What to do with the clips
    #[command(subcommand)]
    pub action: BatchAction,
}

/// The actions on many clips.
#[derive(Debug, Subcommand)]
pub enum BatchAction {
    /// List clips and settings in a manifest
    Plan(Box<plan::BatchPlan>),
    /// Run one job of a manifest
    Run(run::BatchRun),
    /// Submit the jobs of a manifest to Slurm, as an array
    Submit(BatchSubmit),
    /// Show the progress of a manifest's jobs
    Status(BatchStatus),
}

/// `minute4d batch submit`
#[derive(Debug, Args)]
pub struct BatchSubmit {
    /// The manifest
    #[arg(long, value_name = "FILE")]
    pub manifest: PathBuf,
    /// Maximum number of array tasks that run at the same time
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub max_parallel: Option<u32>,
    /// Write the script without submitting it
    #[arg(long)]
    pub dry_run: bool,
    /// Options of sbatch, such as --gres=gpu:1 --cpus-per-task=8 --time=02:00:00
    #[arg(last = true, value_name = "SBATCH OPTIONS")]
    pub options: Vec<String>,
}

/// `minute4d batch status`
#[derive(Debug, Args)]
pub struct BatchStatus {
    /// The manifest
    #[arg(long, value_name = "FILE")]
    pub manifest: PathBuf,
    /// List only the jobs that failed or are to be repeated
    #[arg(long)]
    pub failed: bool,
    /// Write an HTML page with an image and the metrics of every clip (one self-contained file)
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
}
pub fn run(args: &Batch, common: &Common, output: &Output) -> Result<(), Failure> {
    match &args.action {
        BatchAction::Plan(args) => plan::run(args, output),
        BatchAction::Run(args) => run::run(args, common, output),
        BatchAction::Submit(args) => submit_jobs(args, output),
        BatchAction::Status(args) => status(args, output),
    }
}

/// Returns the BLAKE3 hash of an input, as recorded in its run.
fn hash(path: &Path) -> Result<String, String> {
    minute4d::hash_of_path(path).map_err(|e| chain(&e))
}

impl From<BatchError> for Failure {
    fn from(error: BatchError) -> Self {
        Self { code: Category::from(error.kind()).exit_code(), reason: chain(&error) }
    }
}

fn submit_jobs(args: &BatchSubmit, output: &Output) -> Result<(), Failure> {
    let path = absolute(&args.manifest)?;
    let manifest = Manifest::read(&path)?;
    let program = program()?;
    let logs = path.with_extension("logs");
    let script = Script {
        program: &program,
        manifest: &path,
        logs: &logs,
        jobs: manifest.jobs.len(),
        largest: largest_array(),
        max_parallel: args.max_parallel,
        options: &args.options,
    };
    let (file, text, arrays) = (path.with_extension("sbatch"), script.text()?, script.arrays());
    let failed = |path: &Path| {
        let path = path.to_path_buf();
        move |source| Error::Write { path, source }
    };
    // Slurm silently drops logs for a folder that does not exist.
    std::fs::create_dir_all(&logs).map_err(failed(&logs))?;
    atomic::write(&file, text.as_bytes()).map_err(failed(&file))?;
    output.note(&format!("{} jobs in {} array(s); logs in {}", manifest.jobs.len(), arrays.len(), logs.display()));
    let mut ids = Vec::new();
    if !args.dry_run {
        for (first, tasks) in &arrays {
            ids.push(submit(&file, *first, tasks)?);
        }
        output.note(&format!("`minute4d batch status --manifest {}` shows their progress", path.display()));
    }
    let text = match args.dry_run {
        true => file.display().to_string(),
        false => ids.join("\n"),
    };
    let indices: Vec<&String> = arrays.iter().map(|(_, tasks)| tasks).collect();
    output.result(
        &text,
        json!({"script": file, "arrays": indices, "logs": logs, "submitted": !args.dry_run, "ids": ids}),
    );
    Ok(())
}

fn status(args: &BatchStatus, output: &Output) -> Result<(), Failure> {
    let manifest = Manifest::read(&args.manifest)?;
    let mut report = Report::read(&manifest)?;
    if let Some(path) = &args.html {
        let title = args.manifest.file_stem().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        atomic::write(path, page(&report, &title).as_bytes())
            .map_err(|source| Error::Write { path: path.clone(), source })?;
        output.note(&format!("overview of all clips written to {}", path.display()));
    }
    let table = report.table(args.failed);
    if args.failed {
        report.clips.retain(|clip| clip.state.is_trouble());
    }
    output.result(&table, minute4d::plain_json(&report)?);
    Ok(())
}

/// Returns the absolute path.
fn absolute(path: &Path) -> Result<PathBuf, Failure> {
    std::path::absolute(path).map_err(|source| Error::Read { path: path.to_path_buf(), source }.into())
}
