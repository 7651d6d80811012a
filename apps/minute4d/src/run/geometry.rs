//! The first stage: turns a video into a capture on disk.

use super::Job;
use super::folder::CaptureFolder;
use super::record::{GeometryRecord, Input};
use minute4d::geometry::{Plan, compute};
use minute4d::json::plain_json;
use minute4d::settings::part_to_toml;
use minute4d::{Error, enhance, hash};
use std::path::Path;

/// Name of the stage.
pub const STAGE: &str = "geometry";

/// Makes a capture of a video or a folder of images, or finds that it was made before.
///
/// # Errors
///
/// [`Error`]: the input cannot be read, the folder cannot be used, or nothing can be reconstructed.
pub fn make(input: &Path, capture: &Path, job: &Job<'_>) -> Result<GeometryRecord, Error> {
    if !input.exists() {
        return Err(Error::Missing {
            what: "video or folder of images",
            path: input.to_path_buf(),
        });
    }
    let blake3 = hash::of_input(input, Some(capture), job.observer)?;
    of_source(
        input,
        Input {
            path: input.display().to_string(),
            blake3,
        },
        capture,
        job,
    )
}

/// The same of an `input` whose hash is in `source`.
pub(crate) fn of_source(
    input: &Path,
    source: Input,
    capture: &Path,
    job: &Job<'_>,
) -> Result<GeometryRecord, Error> {
    let plan = Plan::new(&job.settings, job.device.choice)?;
    let part = plan.dependencies()?;
    let key = hash::of_parts(&[
        STAGE,
        env!("CARGO_PKG_VERSION"),
        &source.blake3,
        &part_to_toml(&part)?,
    ]);
    let record = GeometryRecord::begin(source, key, plain_json(&part)?);
    let inputs: Vec<&Path> = [input]
        .into_iter()
        .chain(job.settings.geometry.files())
        .collect();
    let mut folder = CaptureFolder::open(capture, job.existing, record, &inputs, job.observer)?;
    if let Some(earlier) = folder.reused(STAGE) {
        return Ok(earlier);
    }
    folder.stage(STAGE, |folder, steps| {
        let result = compute(input, &plan, steps)?;
        enhance::write(
            &folder.next(),
            &result.capture,
            result.objects.as_ref(),
            steps.observer(),
        )?;
        folder.record.found = Some(result.summary);
        Ok(())
    })?;
    Ok(folder.record)
}
