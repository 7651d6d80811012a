//! `minute4d batch plan`: writes clips and settings into a manifest.

use super::super::settings::{print_config, settings};
use crate::args::BatchPlan;
use crate::failure::Failure;
use crate::output::{Output, duration};
use minute4d::Settings;
use minute4d::batch::{Arguments, Plan, plan};
use minute4d::io::atomic::AtomicFile;
use minute4d::settings::Layers;
use serde_json::json;
use std::io::Write;
use std::path::{Path, PathBuf};

pub fn run(args: &BatchPlan, output: &Output) -> Result<(), Failure> {
    let mut settings = settings(&args.settings, Some(&args.video), Some(&args.length))?;
    args.without.apply(&mut settings);
    settings.viewer.write &= !args.no_viewer;
    if let Some(seconds) = args.time_limit {
        settings.limit.time_s = seconds;
    }
    let (Some(manifest), Some(results), false) = (&args.manifest, &args.out, args.settings.print_config) else {
        return print_config(&settings, output);
    };
    make_paths_absolute(&mut settings)?;
    args.device.request()?;
    let results = absolute(results)?;
    let planned = plan(&Plan {
        given: &args.given,
        recursive: args.recursive,
        results: &results,
        run: arguments(args, &settings, manifest)?,
        hash: &super::hash,
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
    let failed = |source| minute4d::Error::Write {
        path: manifest.to_path_buf(),
        source,
    };
    let mut file = AtomicFile::create(manifest).map_err(failed)?;
    file.write_all(text.as_bytes())
        .and_then(|()| file.sync())
        .map_err(failed)?;
    let again = Layers::default().file(file.temporary_path())?.finish()?;
    if again != *settings {
        return Err(minute4d::Error::Internal {
            what: "the settings do not read back as they were written".to_owned(),
        }
        .into());
    }
    let mut arguments = vec!["--device".to_owned(), args.device.device.to_string()];
    if let Some(mb) = args.device.max_vram {
        arguments.extend(["--max-vram".to_owned(), mb.to_string()]);
    }
    // Not part of the settings: the user who plans grants this permission, a file cannot.
    if args.reach.allow_outside {
        arguments.push("--allow-outside".to_owned());
    }
    Ok(Arguments {
        settings: text,
        arguments,
    })
}

/// Makes the paths in the settings absolute, since jobs may start in another folder.
fn make_paths_absolute(settings: &mut Settings) -> Result<(), Failure> {
    let geometry = &mut settings.geometry;
    for path in [&mut geometry.poses, &mut geometry.masks, &mut geometry.depth]
        .into_iter()
        .flatten()
    {
        *path = absolute(path)?;
    }
    // The value holds numbers, unless a file of that name exists.
    if let Some(lens) = geometry.intrinsics.as_mut().filter(|lens| Path::new(lens).is_file()) {
        *lens = absolute(Path::new(lens))?.display().to_string();
    }
    Ok(())
}

/// Returns the absolute path.
fn absolute(path: &Path) -> Result<PathBuf, Failure> {
    std::path::absolute(path).map_err(|source| {
        minute4d::Error::Read {
            path: path.to_path_buf(),
            source,
        }
        .into()
    })
}
