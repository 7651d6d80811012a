//! `minute4d batch status`: shows the progress of all jobs.

use crate::args::BatchStatus;
use crate::failure::Failure;
use crate::output::Output;
use minute4d::batch::{Manifest, Report, page};
use minute4d::io::atomic;

pub fn run(args: &BatchStatus, output: &Output) -> Result<(), Failure> {
    let manifest = Manifest::read(&args.manifest)?;
    let mut report = Report::read(&manifest)?;
    if let Some(path) = &args.html {
        let title = args
            .manifest
            .file_stem()
            .map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        atomic::write(path, page(&report, &title).as_bytes()).map_err(|source| minute4d::Error::Write {
            path: path.clone(),
            source,
        })?;
        output.note(&format!("overview of all clips written to {}", path.display()));
    }
    let table = report.table(args.failed);
    if args.failed {
        report.clips.retain(|clip| clip.state.is_trouble());
    }
    output.result(&table, minute4d::plain_json(&report)?);
    Ok(())
}
