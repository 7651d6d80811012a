//! `minute4d batch`: processes many clips as jobs of a scheduler.

use crate::batch::slurm::{Script, largest_array, submit};
use crate::batch::{
    Arguments, JobEnd, Manifest, Outcome, Report, Tools, index_of_environment, page, plan, run_job,
};
use crate::failure::Failure;
use crate::options::Common;
use crate::options::{TrainingArgs, VideoArgs, print_config};
use crate::output::{Output, duration};
use crate::program::program;
use crate::report_file;
use clap::{Args, Subcommand};
use minute4d::{Category, Error, Settings};
use serde_json::json;
use std::path::{Path, PathBuf};
use sysinfo::System;

#[derive(Debug, Args)]
pub struct Batch {
    /// What to do with the clips
    #[command(subcommand)]
    pub action: BatchAction,
}

#[derive(Debug, Subcommand)]
pub enum BatchAction {
    /// List clips and settings in a manifest
    Plan(Box<BatchPlan>),
    /// Run one job of a manifest
    Run(BatchRun),
    /// Submit the jobs of a manifest to Slurm, as an array
    Submit(BatchSubmit),
    /// Show the progress of a manifest's jobs
    Status(BatchStatus),
}

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
        BatchAction::Plan(args) => run_plan(args, output),
        BatchAction::Run(args) => run_index(args, common, output),
        BatchAction::Submit(args) => submit_jobs(args, output),
        BatchAction::Status(args) => status(args, output),
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
    let (file, text, arrays) = (
        path.with_extension("sbatch"),
        script.text().map_err(Error::from)?,
        script.arrays(),
    );
    // Slurm silently drops logs for a folder that does not exist.
    std::fs::create_dir_all(&logs).map_err(Error::write(&logs))?;
    report_file::write(&file, text.as_bytes())?;
    output.note(&format!(
        "{} jobs in {} array(s); logs in {}",
        manifest.jobs.len(),
        arrays.len(),
        logs.display()
    ));
    let mut ids = Vec::new();
    if !args.dry_run {
        for (first, tasks) in &arrays {
            ids.push(submit(&file, *first, tasks).map_err(Error::from)?);
        }
        output.note(&format!(
            "`minute4d batch status --manifest {}` shows their progress",
            path.display()
        ));
    }
    let text = match args.dry_run {
        true => file.display().to_string(),
        false => ids.join("\n"),
    };
    let indices: Vec<&String> = arrays.iter().map(|(_, tasks)| tasks).collect();
    Ok(output.result(
        &text,
        &json!({"script": file, "arrays": indices, "logs": logs, "submitted": !args.dry_run, "ids": ids}),
    )?)
}

fn status(args: &BatchStatus, output: &Output) -> Result<(), Failure> {
    let manifest = Manifest::read(&args.manifest)?;
    let mut report = Report::read(&manifest)?;
    if let Some(path) = &args.html {
        let title = args
            .manifest
            .file_stem()
            .map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        report_file::write(path, page(&report, &title).as_bytes())?;
        output.note(&format!(
            "overview of all clips written to {}",
            path.display()
        ));
    }
    let table = report.table(args.failed);
    if args.failed {
        report.clips.retain(|clip| clip.state.is_trouble());
    }
    Ok(output.result(&table, &report)?)
}

fn absolute(path: &Path) -> Result<PathBuf, Failure> {
    Ok(std::path::absolute(path).map_err(Error::read(path))?)
}

#[derive(Debug, Args)]
pub struct BatchPlan {
    /// Videos, or folders of videos
    #[arg(required_unless_present = "print_config", value_name = "VIDEOS")]
    pub given: Vec<String>,
    /// The manifest to write
    #[arg(
        short = 'o',
        value_name = "FILE",
        required_unless_present = "print_config"
    )]
    pub manifest: Option<PathBuf>,
    /// Folder for the results, with one folder per clip in it
    #[arg(long, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// Search folders recursively
    #[arg(long)]
    pub recursive: bool,
    /// Replace an existing manifest
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub video: VideoArgs,
    #[command(flatten)]
    pub training: TrainingArgs,
}

fn run_plan(args: &BatchPlan, output: &Output) -> Result<(), Failure> {
    let mut settings = args.training.settings(Some(&args.video))?;
    let (Some(manifest), Some(results), false) = (
        &args.manifest,
        &args.out,
        args.training.settings.print_config,
    ) else {
        return print_config(&settings, output);
    };
    make_paths_absolute(&mut settings)?;
    args.training.device.request()?;
    let results = absolute(results)?;
    let run = arguments(args, &settings)?;
    let planned = plan(&args.given, args.recursive, &results, run, output)?;
    planned.write(manifest, args.force)?;
    let training = settings.train.budget_s.max(0.0) * planned.jobs.len() as f64;
    let spent = match training > 0.0 {
        true => format!("; training alone takes {}", duration(training)),
        false => String::new(),
    };
    output.note(&format!(
        "{} clips{spent}; `minute4d batch submit --manifest {}` submits them to Slurm, and any scheduler may start \
         `minute4d batch run` with --index 0 to {}",
        planned.jobs.len(),
        manifest.display(),
        planned.jobs.len() - 1
    ));
    let ids: Vec<&str> = planned.jobs.iter().map(|j| j.id.as_str()).collect();
    Ok(output.result(
        manifest.display(),
        &json!({"path": manifest, "jobs": ids.len(), "ids": ids, "training_s": training, "results": results}),
    )?)
}

/// Returns the arguments of every run.
fn arguments(args: &BatchPlan, settings: &Settings) -> Result<Arguments, Failure> {
    let mut arguments = vec![
        "--device".to_owned(),
        args.training.device.device.to_string(),
    ];
    if let Some(mb) = args.training.device.max_vram {
        arguments.extend(["--max-vram".to_owned(), mb.to_string()]);
    }
    // Not part of the settings: the user who plans grants this permission, a file cannot.
    if args.training.reach.allow_outside {
        arguments.push("--allow-outside".to_owned());
    }
    Ok(Arguments {
        settings: settings.to_toml()?,
        arguments,
    })
}

/// Makes the paths in the settings absolute, since jobs may start in another folder.
fn make_paths_absolute(settings: &mut Settings) -> Result<(), Failure> {
    let geometry = &mut settings.geometry;
    for path in [
        &mut geometry.poses,
        &mut geometry.masks,
        &mut geometry.depth,
    ]
    .into_iter()
    .flatten()
    {
        *path = absolute(path)?;
    }
    // The value holds numbers, unless a file of that name exists.
    if let Some(lens) = geometry
        .intrinsics
        .as_mut()
        .filter(|lens| Path::new(lens).is_file())
    {
        *lens = absolute(Path::new(lens))?.display().to_string();
    }
    Ok(())
}

#[derive(Debug, Args)]
pub struct BatchRun {
    /// The manifest
    #[arg(long, value_name = "FILE")]
    pub manifest: PathBuf,
    /// Index of the job, counted from 0 [default: SLURM_ARRAY_TASK_ID or JOB_COMPLETION_INDEX,
    /// whichever is set first]
    #[arg(long, value_name = "N")]
    pub index: Option<usize>,
    /// Run the job again even if it failed permanently
    #[arg(long)]
    pub retry_failed: bool,
}

fn run_index(args: &BatchRun, common: &Common, output: &Output) -> Result<(), Failure> {
    output.stop().of_an_engine();
    let manifest = Manifest::read(&args.manifest).map_err(batch_failure)?;
    let index = match args.index {
        Some(index) => Some(index),
        None => index_of_environment(|name| std::env::var(name).ok())?,
    };
    let Some(index) = index else {
        let last = manifest.jobs.len().saturating_sub(1);
        return Err(Failure::usage(&format!(
            "no job index: pass --index from 0 to {last}; a scheduler starts one process per job (docs/batch.md)"
        )));
    };
    let tools = Tools {
        program: program()?,
        arguments: common
            .threads
            .map_or_else(Vec::new, |n| vec!["--threads".to_owned(), n.to_string()]),
        host: System::host_name().unwrap_or_else(|_| "unknown".to_owned()),
    };
    let end =
        run_job(&manifest, index, args.retry_failed, &tools, output).map_err(batch_failure)?;
    let id = &manifest.jobs[index].id;
    let text = describe(id, &end);
    output.result(
        &text,
        &json!({"index": index, "id": id, "outcome": end.outcome, "seconds": end.seconds, "reason": end.reason}),
    )?;
    let code = match end.outcome {
        Outcome::Done => return Ok(()),
        Outcome::Failed => Category::BadInput.exit_code(),
        // Ctrl-C keeps its own code, so that the scheduler does not run the job again.
        Outcome::Retryable => {
            let pressed = output
                .stop()
                .code()
                .filter(|&code| code == Category::Stopped.exit_code());
            pressed.unwrap_or(Category::TryAgain.exit_code())
        }
    };
    Err(Failure { code, reason: text })
}

/// Maps an error outside the clip to an exit code: files that cannot be read or written may work
/// later or on another machine; a bad manifest is bad settings.
fn batch_failure(error: Error) -> Failure {
    let category = match &error {
        Error::Read { .. } | Error::Write { .. } => Category::TryAgain,
        Error::Refused(refusal) if refusal.category == Category::BadInput => Category::BadSettings,
        _ => return error.into(),
    };
    Failure {
        code: category.exit_code(),
        ..error.into()
    }
}

fn describe(id: &str, end: &JobEnd) -> String {
    match (end.outcome, end.seconds) {
        (Outcome::Done, Some(seconds)) => format!("{id}: done in {}", duration(seconds)),
        (Outcome::Done, None) => format!("{id}: already done"),
        (Outcome::Failed, Some(_)) => format!("{id} failed permanently: {}", end.reason),
        (Outcome::Failed, None) => {
            format!(
                "{id} failed permanently before and is not run again without --retry-failed: {}",
                end.reason
            )
        }
        (Outcome::Retryable, _) => format!("{id} should be retried: {}", end.reason),
    }
}
