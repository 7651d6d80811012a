//! `minute4d batch plan`: writes clips and settings into a manifest.

use super::{absolute, hash};
use crate::failure::Failure;
use crate::options::{TrainingArgs, VideoArgs, print_config};
use crate::output::{Output, duration};
use clap::Args;
use minute4d::Settings;
use minute4d::batch::{Arguments, Plan, plan};
use minute4d::io::atomic::AtomicFile;
use minute4d::settings::Layers;
use serde_json::json;
use std::io::Write;
use std::path::{Path, PathBuf};

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
    /// The part of each video.
    #[command(flatten)]
    pub video: VideoArgs,
    /// How to train.
    #[command(flatten)]
    pub training: TrainingArgs,
}

pub fn run(args: &BatchPlan, output: &Output) -> Result<(), Failure> {
    let mut settings = args.training.settings(Some(&args.video))?;
    let (Some(manifest), Some(results), false) = (&args.manifest, &args.out, args.training.settings.print_config)
    else {
        return print_config(&settings, output);
    };
    make_paths_absolute(&mut settings)?;
    args.training.device.request()?;
    let results = absolute(results)?;
    let planned = plan(&Plan {
        given: &args.given,
        recursive: args.recursive,
        results: &results,
        run: arguments(args, &settings, manifest)?,
        hash: &hash,
    })?;
    planned.write(manifest, args.force)?;
    let training = settings.train.budget_s.max(0.0) * planned.jobs.len() as f64;
    let bytes: u64 = planned.jobs.iter().map(|j| j.bytes).sum();
    let spent = match training > 0.0 {
        true => format!("; training alone takes {}", duration(training)),
        false => String::new(),
    };
    output.note(&format!(
        "{} clips, {:.1} MB{spent}; `minute4d batch submit --manifest {}` submits them to Slurm, and any scheduler may start \
         `minute4d batch run` with --index 0 to {}",
        planned.jobs.len(),
        bytes as f64 / 1e6,
        manifest.display(),
        planned.jobs.len() - 1
    ));
    let ids: Vec<&str> = planned.jobs.iter().map(|j| j.id.as_str()).collect();
    output.result(
        &manifest.display().to_string(),
        json!({"path": manifest, "jobs": ids.len(), "ids": ids, "bytes": bytes, "training_s": training, "results": results}),
    );
    Ok(())
}

/// Returns the arguments of every run. To make sure that the jobs run what is planned, the settings are written to a temporary
/// file next to the manifest and read back; a difference is an error.
fn arguments(args: &BatchPlan, settings: &Settings, manifest: &Path) -> Result<Arguments, Failure> {
    let text = settings.to_toml()?;
    let failed = |source| minute4d::Error::Write { path: manifest.to_path_buf(), source };
    let mut file = AtomicFile::create(manifest).map_err(failed)?;
    file.write_all(text.as_bytes()).and_then(|()| file.sync()).map_err(failed)?;
    let again = Layers::default().file(file.temporary_path())?.finish()?;
    if again != *settings {
        return Err(minute4d::Error::Internal {
            what: "the settings do not read back as they were written".to_owned(),
        }
        .into());
    }
    let mut arguments = vec!["--device".to_owned(), args.training.device.device.to_string()];
    if let Some(mb) = args.training.device.max_vram {
        arguments.extend(["--max-vram".to_owned(), mb.to_string()]);
    }
    // Not part of the settings: the user who plans grants this permission, a file cannot.
    if args.training.reach.allow_outside {
        arguments.push("--allow-outside".to_owned());
    }
    Ok(Arguments { settings: text, arguments })
}

/// Makes the paths in the settings absolute, since jobs may start in another folder.
fn make_paths_absolute(settings: &mut Settings) -> Result<(), Failure> {
    let geometry = &mut settings.geometry;
    for path in [&mut geometry.poses, &mut geometry.masks, &mut geometry.depth].into_iter().flatten() {
        *path = absolute(path)?;
    }
    // The value holds numbers, unless a file of that name exists.
    if let Some(lens) = geometry.intrinsics.as_mut().filter(|lens| Path::new(lens).is_file()) {
        *lens = absolute(Path::new(lens))?.display().to_string();
    }
    Ok(())
}
