//! `minute4d batch`

use super::{DeviceArgs, LengthArgs, ReachArgs, SettingsArgs, VideoArgs, WithoutArgs, values};
use clap::{Args, Subcommand};
use std::path::PathBuf;

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
    Plan(Box<BatchPlan>),
    /// Run one job of a manifest
    Run(BatchRun),
    /// Submit the jobs of a manifest to Slurm, as an array
    Submit(BatchSubmit),
    /// Show the progress of a manifest's jobs
    Status(BatchStatus),
}

/// `minute4d batch plan`
#[derive(Debug, Args)]
pub struct BatchPlan {
    /// Videos, folders, or @LIST, a text file with one of these per line
    #[arg(required_unless_present = "print_config", value_name = "VIDEOS")]
    pub given: Vec<String>,
    /// The manifest to write
    #[arg(short = 'o', value_name = "FILE", required_unless_present = "print_config")]
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
    /// The length of training.
    #[command(flatten)]
    pub length: LengthArgs,
    /// Time limit of each run, as `--time-limit` of `run`
    #[arg(long, value_name = "TIME", value_parser = values::duration)]
    pub time_limit: Option<f64>,
    /// The part of each video.
    #[command(flatten)]
    pub video: VideoArgs,
    /// The device for training.
    #[command(flatten)]
    pub device: DeviceArgs,
    /// Parts of the method to switch off.
    #[command(flatten)]
    pub without: WithoutArgs,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// Do not write viewer.html
    #[arg(long)]
    pub no_viewer: bool,
    /// Which files a capture may refer to.
    #[command(flatten)]
    pub reach: ReachArgs,
}

/// `minute4d batch run`
#[derive(Debug, Args)]
pub struct BatchRun {
    /// The manifest
    #[arg(long, value_name = "FILE")]
    pub manifest: PathBuf,
    /// Index of the job, counted from 0 [default: SLURM_ARRAY_TASK_ID or JOB_COMPLETION_INDEX, whichever is set first]
    #[arg(long, value_name = "N")]
    pub index: Option<usize>,
    /// Run the job again even if it failed permanently
    #[arg(long)]
    pub retry_failed: bool,
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
