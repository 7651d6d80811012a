//! `minute4d batch`

use super::{DeviceArgs, LengthArgs, ReachArgs, SettingsArgs, VideoArgs, WithoutArgs, values};
use clap::{Args, Subcommand, ValueEnum};
use std::path::PathBuf;

/// `minute4d batch`
#[derive(Debug, Args)]
pub struct Batch {
    /// What to do with many clips
    #[command(subcommand)]
    pub action: BatchAction,
}

/// What is done with many clips.
#[derive(Debug, Subcommand)]
pub enum BatchAction {
    /// List clips and settings in a manifest
    Plan(Box<BatchPlan>),
    /// Do the jobs of a manifest, together with any number of other workers
    Run(BatchRun),
    /// Hand a manifest to a cluster
    Submit(BatchSubmit),
    /// Say how far the jobs of a manifest are, from their results alone
    Status(BatchStatus),
}

/// `minute4d batch plan`
#[derive(Debug, Args)]
pub struct BatchPlan {
    /// Videos, folders, patterns such as 'clips/*.mp4', or @LIST, a text file with one of these a line
    #[arg(required_unless_present = "print_config", value_name = "VIDEOS")]
    pub given: Vec<String>,
    /// The manifest
    #[arg(short = 'o', value_name = "FILE", required_unless_present = "print_config")]
    pub manifest: Option<PathBuf>,
    /// Folder for the results, one folder a clip in it
    #[arg(long, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// Look into folders of folders
    #[arg(long)]
    pub recursive: bool,
    /// Replace a manifest that is already there
    #[arg(long)]
    pub force: bool,
    /// How long to train.
    #[command(flatten)]
    pub length: LengthArgs,
    /// End each run in time, as `run` does with the same option
    #[arg(long, value_name = "TIME", value_parser = values::duration)]
    pub time_limit: Option<f64>,
    /// Which part of each video.
    #[command(flatten)]
    pub video: VideoArgs,
    /// Where to train.
    #[command(flatten)]
    pub device: DeviceArgs,
    /// What to go without.
    #[command(flatten)]
    pub without: WithoutArgs,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// Do not write viewer.html
    #[arg(long)]
    pub no_viewer: bool,
    /// Which files it may name.
    #[command(flatten)]
    pub reach: ReachArgs,
}

/// `minute4d batch run`
#[derive(Debug, Args)]
pub struct BatchRun {
    /// The manifest
    #[arg(long, value_name = "FILE")]
    pub manifest: PathBuf,
    /// Do this job alone, counted from 0 [default: SLURM_ARRAY_TASK_ID, JOB_COMPLETION_INDEX, AWS_BATCH_JOB_ARRAY_INDEX or
    /// HQ_TASK_ID, whichever is set first; without any, all jobs]
    #[arg(long, value_name = "I")]
    pub index: Option<usize>,
    /// With an index: do every N-th job from it on
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub stride: Option<u32>,
    /// Make scenes in this folder and copy them when they are whole [default: beside the results]
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
    /// A worker that has not been heard of for so long counts as dead, and its job is another's
    #[arg(long, value_name = "S", default_value = "120", value_parser = clap::value_parser!(u32).range(4..=86_400))]
    pub lease_seconds: u32,
    /// Give a clip up after so many crashes
    #[arg(long, value_name = "N", default_value = "3", value_parser = clap::value_parser!(u32).range(1..=100))]
    pub attempts: u32,
    /// Try again what was given up
    #[arg(long)]
    pub retry_failed: bool,
    /// Do not wait for jobs that other workers have
    #[arg(long)]
    pub no_wait: bool,
}

/// `minute4d batch submit`
#[derive(Debug, Args)]
pub struct BatchSubmit {
    /// The manifest
    #[arg(long, value_name = "FILE")]
    pub manifest: PathBuf,
    /// What the cluster runs
    #[arg(long, value_enum, default_value = "slurm")]
    pub engine: Engine,
    /// GPUs a task
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub gpus: Option<u32>,
    /// Most tasks at work at once
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub max_parallel: Option<u32>,
    /// Time of a task, such as 02:00:00; it is told to save two minutes before its end and put into the queue again
    #[arg(long, value_name = "T")]
    pub time: Option<String>,
    /// The partition
    #[arg(long, value_name = "P")]
    pub partition: Option<String>,
    /// Cores a task
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub cpus: Option<u32>,
    /// Memory of a task, such as 16G
    #[arg(long, value_name = "M")]
    pub mem: Option<String>,
    /// Anything else for sbatch, such as --sbatch-arg=--account=me; may be given more than once
    #[arg(long, value_name = "ARG", allow_hyphen_values = true)]
    pub sbatch_arg: Vec<String>,
    /// Make scenes in this folder of the node and copy them when they are whole
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
    /// Seconds after which a worker that is not heard of counts as dead
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u32).range(4..=86_400))]
    pub lease_seconds: Option<u32>,
    /// Write the script and do not submit it
    #[arg(long)]
    pub dry_run: bool,
}

/// What a cluster runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Engine {
    /// Slurm, as an array of jobs
    Slurm,
}

/// `minute4d batch status`
#[derive(Debug, Args)]
pub struct BatchStatus {
    /// The manifest
    #[arg(long, value_name = "FILE")]
    pub manifest: PathBuf,
    /// List troubles alone
    #[arg(long)]
    pub failed: bool,
    /// Write a page with a picture and the figures of every clip; one file that loads nothing
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// A worker that has not been heard of for so long counts as dead
    #[arg(long, value_name = "S", default_value = "120", value_parser = clap::value_parser!(u32).range(4..=86_400))]
    pub lease_seconds: u32,
}
