//! The last stage of a run: writes the page.

use super::workspace::{Task, Workspace};
use m4_core::Scene;
use m4_viewer::page::TEMPLATE;
use minute4d::hash::{self, HashedCapture};
use minute4d::layout::{CAPTURE_FOLDER, SCENE_FILE, VIEWER_FILE};
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
    Write {
        key: String,
        because: Option<&'static str>,
    },
}

/// Decides that, once the scene of the run is written.
pub(crate) fn plan(run: &Workspace<'_>, capture: &HashedCapture) -> Result<Plan, Error> {
    let config = &run.job.settings.viewer;
    if !config.write {
        return Ok(Plan::Nothing);
    }
    let scene_hash = run
        .record
        .files
        .get(SCENE_FILE)
        .map_or("", |f| f.blake3.as_str());
    let key = hash::of_parts(&[
        STAGE,
        env!("CARGO_PKG_VERSION"),
        scene_hash,
        &capture.hash,
        &part_to_toml(config)?,
        &hash::of_parts(&[TEMPLATE, &title(run.place(), &run.record.input.path)]),
    ]);
    Ok(match run.task(STAGE, &key, &[VIEWER_FILE])? {
        Task::Reuse => Plan::Reuse,
        Task::Work { because, .. } => Plan::Write { key, because },
    })
}

/// Does what was planned: writes `page`, which there is where one is to be written.
pub(crate) fn stage(run: &mut Workspace<'_>, plan: Plan, page: Option<Page>) -> Result<(), Error> {
    match (plan, page) {
        (Plan::Write { key, because }, Some(page)) => {
            run.stage(STAGE, key, (because, 0.0), &[VIEWER_FILE], |run, _| {
                page.write(&run.path(VIEWER_FILE))
            })
        }
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
