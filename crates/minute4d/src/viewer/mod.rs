//! Shows scenes in a browser: `viewer.html` of a run, and the same page from a local server.
//!
//! [`stage`](self) writes the page as the last stage of a run. [`view()`] serves an existing scene and
//! shows every newer one; [`Broadcast`] does the same from within the training process.

mod broadcast;
mod view;

pub use broadcast::Broadcast;
pub use view::{Viewing, view};

use crate::error::OutputError;
use crate::folder::{CAPTURE_FOLDER, SCENE_FILE, VIEWER_FILE};
use crate::hash::{self, HashedCapture};
use crate::render::{Painter, source_fps};
use crate::settings::part_to_toml;
use crate::workspace::{Task, Workspace};
use crate::{Error, StageEvent};
use m4_core::{Capture, RgbImage, Scene};
use m4_io::atomic::AtomicFile;
use m4_kernels::SimdLevel;
use m4_viewer::page::{self, Compression, Parts, TEMPLATE};
use m4_viewer::payload::{Payload, encode};
use m4_viewer::{About, FRAME_BYTES, Frames, Manifest, encode_frames};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io::Write;
use std::path::Path;

/// Name of the stage.
pub const STAGE: &str = "viewer";

/// Contents of the page of a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ViewerConfig {
    /// Write `viewer.html` at the end of a run.
    pub write: bool,
}

impl Default for ViewerConfig {
    fn default() -> Self {
        Self { write: true }
    }
}

/// The splats for the page, and their metadata.
pub(crate) type Packed = (Manifest, Payload);

/// Packs the splats of a scene for the page, and describes them. `median_depth`: of what the middle camera
/// sees, world units.
fn pack(scene: &Scene, title: &str, median_depth: f64) -> Packed {
    let payload = encode(scene, median_depth);
    let about = About { title, median_depth, fps: source_fps(scene) };
    (Manifest::new(scene, &payload, &about), payload)
}

/// The same for the page of a run; `None` where none is wanted.
pub(crate) fn packed(run: &Workspace<'_>, scene: &Scene) -> Option<Packed> {
    let title = title(run.place(), &run.record.input.path);
    run.job.settings.viewer.write.then(|| pack(scene, &title, median_depth(scene, run.level)))
}

/// Median z-depth of the view of the middle camera, world units; 1 for an empty view.
fn median_depth(scene: &Scene, level: SimdLevel) -> f64 {
    let middle = scene.source.get(scene.source.len() / 2);
    let depth = middle.and_then(|s| Painter::new(scene, level).median_depth(&s.camera, s.t));
    depth.unwrap_or(1.0)
}

/// The frames of a capture for the page of a scene; `None` where they are not those of its cameras.
fn frames(capture: &Capture, scene: &Scene) -> Result<Option<Frames>, Error> {
    if capture.frames.len() != scene.source.len() {
        return Ok(None);
    }
    let images: Vec<&RgbImage> = capture.frames.iter().map(|f| &f.rgb).collect();
    Ok(encode_frames(&images, FRAME_BYTES)?)
}

/// What is to be done for the page of a run.
pub(crate) enum Plan {
    /// None is wanted.
    Nothing,
    /// It was written before.
    Reuse,
    /// It is written again; seconds of an earlier attempt do not count.
    Write { key: String, because: Option<&'static str> },
}

/// Decides that, once the scene of the run is written.
pub(crate) fn plan(run: &Workspace<'_>, capture: &HashedCapture) -> Result<Plan, Error> {
    let config = &run.job.settings.viewer;
    if !config.write {
        return Ok(Plan::Nothing);
    }
    let scene_hash = run.record.files.get(SCENE_FILE).map_or("", |f| f.blake3.as_str());
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

/// A page that is not written yet.
pub(crate) struct Page {
    manifest: Manifest,
    payload: Payload,
    frames: Option<Frames>,
    html: Vec<u8>,
}

impl Page {
    /// Adds the frames of the capture to the splats, and compresses all.
    pub fn new((mut manifest, payload): Packed, capture: &Capture, scene: &Scene) -> Result<Self, Error> {
        let frames = frames(capture, scene)?;
        manifest.frames = frames.as_ref().map(|f| f.index.clone());
        let parts = Parts { manifest: &manifest, payload: Some(&payload.bytes), frames: frames.as_ref() };
        let html = page::compose(TEMPLATE, &parts, Compression::default())?;
        Ok(Self { manifest, payload, frames, html })
    }

    /// Writes the page, reads it back and compares.
    fn write(self, path: &Path) -> Result<(), Error> {
        let failed = |source| Error::Write { path: path.to_path_buf(), source };
        let mut file = AtomicFile::create(path).map_err(failed)?;
        file.write_all(&self.html).map_err(failed)?;
        drop(self.html);
        file.sync().map_err(failed)?;
        let text = fs::read_to_string(file.temporary_path())
            .map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
        let back = page::read(&text)?;
        let same = back.manifest == self.manifest
            && back.payload.as_ref() == Some(&self.payload.bytes)
            && back.frames == self.frames;
        if !same {
            let what = "the scene in it differs".to_owned();
            return Err(OutputError::Verify { path: path.to_path_buf(), what }.into());
        }
        file.commit().map_err(failed)
    }
}

/// Does what was planned: writes `page`, which there is where one is to be written.
pub(crate) fn stage(run: &mut Workspace<'_>, plan: Plan, page: Option<Page>) -> Result<(), Error> {
    match (plan, page) {
        (Plan::Write { key, because }, Some(page)) => {
            run.stage(STAGE, key, (because, 0.0), &[VIEWER_FILE], |run, _| page.write(&run.path(VIEWER_FILE)))
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
