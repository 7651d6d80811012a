//! The first stage: turns a video into a capture on disk.

use super::Job;
use super::folder::CaptureFolder;
use super::record::{GeometryRecord, Source};
use super::stage;
use m4_core::Capture;
use minute4d::geometry::{Plan, compute};
use minute4d::json::plain_json;
use minute4d::settings::part_to_toml;
use minute4d::{Error, enhance};
use std::path::Path;

/// Name of the stage.
pub const STAGE: &str = "geometry";

/// Makes a capture of a video or a folder of images, or finds that it was made before.
///
/// # Errors
///
/// [`Error`]: the input cannot be read, the folder cannot be used, or nothing can be reconstructed.
pub fn make(input: &Path, folder: &Path, job: &Job<'_>) -> Result<GeometryRecord, Error> {
    Error::unless_exists("video or folder of images", input)?;
    let source = Source::read(input, Some(folder), job.observer)?;
    Ok(of_source(&source, folder, job)?.0)
}

/// The same of a hashed `source`. Returns the capture too where it was made now.
pub(crate) fn of_source(
    source: &Source<'_>,
    folder: &Path,
    job: &Job<'_>,
) -> Result<(GeometryRecord, Option<Capture>), Error> {
    let plan = Plan::new(&job.settings, job.device.choice)?;
    let part = plan.dependencies()?;
    let key = stage::key(STAGE, &[&source.blake3, &part_to_toml(&part)?]);
    let record = GeometryRecord::begin(source, key, plain_json(&part)?);
    let files = job.settings.geometry.files();
    let inputs: Vec<&Path> = [source.path].into_iter().chain(files).collect();
    let mut folder = CaptureFolder::open(folder, job.existing, record, &inputs, job.observer)?;
    if let Some(earlier) = folder.reused(STAGE) {
        return Ok((earlier, None));
    }
    let capture = folder.stage(STAGE, |folder, steps| {
        let result = compute(source.path, &plan, steps)?;
        let objects = result.objects.as_ref();
        enhance::write(&folder.next(), &result.capture, objects, steps.observer())?;
        folder.record.found = Some(result.summary);
        Ok(result.capture)
    })?;
    Ok((folder.record, Some(capture)))
}
