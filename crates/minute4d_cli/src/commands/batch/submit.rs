//! `minute4d batch submit`: submits the jobs of a manifest to Slurm.

use crate::args::BatchSubmit;
use crate::failure::Failure;
use crate::output::Output;
use minute4d::Error;
use minute4d::batch::Manifest;
use minute4d::batch::slurm::{Script, largest_array, submit};
use minute4d::io::atomic;
use serde_json::json;
use std::path::{Path, PathBuf};

pub fn run(args: &BatchSubmit, output: &Output) -> Result<(), Failure> {
    let path = absolute(&args.manifest)?;
    let manifest = Manifest::read(&path)?;
    let program = std::env::current_exe().map_err(|e| Error::Internal {
        what: format!("the path of this program is unknown: {e}"),
    })?;
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
    output.note(&format!(
        "{} jobs in {} array(s); logs in {}",
        manifest.jobs.len(),
        arrays.len(),
        logs.display()
    ));
    let mut ids = Vec::new();
    if !args.dry_run {
        for (first, tasks) in &arrays {
            ids.push(submit(&file, *first, tasks)?);
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
    output.result(
        &text,
        json!({"script": file, "arrays": indices, "logs": logs, "submitted": !args.dry_run, "ids": ids}),
    );
    Ok(())
}

fn absolute(path: &Path) -> Result<PathBuf, Failure> {
    std::path::absolute(path).map_err(|source| {
        Error::Read {
            path: path.to_path_buf(),
            source,
        }
        .into()
    })
}
