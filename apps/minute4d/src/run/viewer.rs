//! The last stage of a run: writes the page.

use super::stage;
use super::workspace::{Task, Workspace};
use m4_core::Scene;
use m4_viewer::page::TEMPLATE;
use minute4d::hash::{self, HashedCapture};
use minute4d::layout::{CAPTURE_FOLDER, VIEWER_FILE};
pub use minute4d::page::{Packed, Page};
use minute4d::page::{median_depth, pack};
use minute4d::settings::part_to_toml;
use minute4d::{Error, StageEvent};
use std::path::Path;

/// Name of the stage.
pub const STAGE: &str = "viewer";

/// The splats for the page of a run; `None` where none is wanted.
pub(crate) fn packed(run: &Workspace<'_>, scene: &Scene) -> Option<Packed> {
    let title = title(run.place(), &run.record.input.path);
    run.job
        .settings
        .viewer
        .write
        .then(|| pack(scene, &title, median_depth(scene, run.level)))
}

/// What is to be done for the page of a run.
pub(crate) enum Plan {
    /// None is wanted.
    Nothing,
    /// It was written before.
    Reuse,
    /// It is written again; seconds of an earlier attempt do not count.
    Write(Task),
}

/// Decides that, once the scene of the run is written.
pub(crate) fn plan(run: &Workspace<'_>, capture: &HashedCapture) -> Result<Plan, Error> {
    let config = &run.job.settings.viewer;
    if !config.write {
        return Ok(Plan::Nothing);
    }
    let config = part_to_toml(config)?;
    let page = hash::of_parts(&[TEMPLATE, &title(run.place(), &run.record.input.path)]);
    let key = stage::key(STAGE, &[run.scene_hash(), &capture.hash, &config, &page]);
    Ok(match run.task(STAGE, key, &[VIEWER_FILE])? {
        None => Plan::Reuse,
        Some(mut task) => {
            task.seconds_before = 0.0;
            Plan::Write(task)
        }
    })
}

/// Does what was planned: writes `page`, which there is where one is to be written.
pub(crate) fn make(run: &mut Workspace<'_>, plan: Plan, page: Option<Page>) -> Result<(), Error> {
    match (plan, page) {
        (Plan::Write(task), Some(page)) => run.stage(STAGE, task, &[VIEWER_FILE], |run, _| {
            page.write(&run.path(VIEWER_FILE))
        }),
        (Plan::Reuse, _) => {
            run.job.observer.stage(STAGE, StageEvent::Reused);
            Ok(())
        }
        _ => Ok(()),
    }
}

/// Title of the page: the name of the clip, or of the run where that is more telling.
pub fn title(folder: &Path, input: &str) -> String {
    let stem = Path::new(input).file_stem().and_then(|s| s.to_str());
    let own = folder.file_name().and_then(|s| s.to_str());
    let stem = stem.filter(|s| *s != CAPTURE_FOLDER && !s.starts_with("transforms"));
    stem.or(own).unwrap_or("scene").to_owned()
}
