//! `minute4d batch submit`: a manifest to a cluster.

use crate::args::BatchSubmit;
use crate::failure::Failure;
use crate::output::Output;
use minute4d::Error;
use minute4d::batch::Manifest;
use minute4d::batch::slurm::{Options, Script, largest_array, submit};
use minute4d::io::atomic;
use serde_json::json;
use std::path::{Path, PathBuf};

pub fn run(args: &BatchSubmit, output: &Output) -> Result<(), Failure> {
    let path = whole(&args.manifest)?;
    let manifest = Manifest::read(&path)?;
    let options = Options {
        gpus: args.gpus,
        max_parallel: args.max_parallel,
        time: args.time.clone(),
        partition: args.partition.clone(),
        cpus: args.cpus,
        memory: args.mem.clone(),
        scratch: args.scratch.as_deref().map(whole).transpose()?,
        more: args.sbatch_arg.clone(),
    };
    let program = std::env::current_exe().map_err(|e| Error::Internal {
        what: format!("this program does not know where it is: {e}"),
    })?;
    let logs = path.with_extension("logs");
    let worker = args
        .lease_seconds
        .map_or_else(Vec::new, |s| vec!["--lease-seconds".to_owned(), s.to_string()]);
    let script = Script {
        program: &program,
        manifest: &path,
        logs: &logs,
        jobs: manifest.jobs.len(),
        largest: largest_array(),
        options: &options,
        worker: &worker,
    };
    let (file, text, tasks) = (path.with_extension("sbatch"), script.text()?, script.tasks());
    let failed = |path: &Path| {
        let path = path.to_path_buf();
        move |source| Error::Write { path, source }
    };
    // Slurm writes no log into a folder that is not there, and says nothing about it.
    std::fs::create_dir_all(&logs).map_err(failed(&logs))?;
    atomic::write(&file, text.as_bytes()).map_err(failed(&file))?;
    output.note(&format!(
        "{} jobs in {tasks} tasks; they write to {}",
        manifest.jobs.len(),
        logs.display()
    ));
    if args.dry_run {
        let value = json!({"script": file, "tasks": tasks, "logs": logs, "submitted": false});
        output.result(&file.display().to_string(), value);
        return Ok(());
    }
    let id = submit(&file)?;
    output.note(&format!(
        "`minute4d batch status --manifest {}` says how far they are",
        path.display()
    ));
    let value = json!({"script": file, "tasks": tasks, "logs": logs, "submitted": true, "job": id});
    output.result(&id, value);
    Ok(())
}

fn whole(path: &Path) -> Result<PathBuf, Failure> {
    std::path::absolute(path).map_err(|source| {
        Error::Read {
            path: path.to_path_buf(),
            source,
        }
        .into()
    })
}
