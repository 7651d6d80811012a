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
use crate::render::{Painter, source_fps};
use crate::settings::part_to_toml;
use crate::workspace::{Task, Workspace};
use crate::{Error, StageEvent, hash};
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

/// The splats for the page, and their metadata. `median_depth`: of what the middle camera
/// sees, world units.
fn pack(scene: &Scene, title: &str, median_depth: f64) -> (Manifest, Payload) {
    let payload = encode(scene, median_depth);
    let about = About { title, median_depth, fps: source_fps(scene) };
    (Manifest::new(scene, &payload, &about), payload)
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

/// Writes the page within a run, unless that was done before or is not wanted.
pub(crate) fn stage(run: &mut Workspace<'_>, capture: &Capture, scene: &Scene) -> Result<(), Error> {
    let config = &run.job.settings.viewer;
    if !config.write {
        return Ok(());
    }
    let scene_hash = run.record.files.get(SCENE_FILE).map_or("", |f| f.blake3.as_str());
    let title = title(run.place(), &run.record.input.path);
    let key = hash::of_parts(&[
        STAGE,
        env!("CARGO_PKG_VERSION"),
        scene_hash,
        &hash::of_capture(capture),
        &part_to_toml(config)?,
        &hash::of_parts(&[TEMPLATE, &title]),
    ]);
    let task = match run.task(STAGE, &key, &[VIEWER_FILE])? {
        Task::Reuse => {
            run.job.observer.stage(STAGE, StageEvent::Reused);
            return Ok(());
        }
        // A page is written again, so seconds of an earlier attempt do not count.
        Task::Work { because, .. } => (because, 0.0),
    };
    run.stage(STAGE, key, task, &[VIEWER_FILE], |run, _| write(run, &title, capture, scene))
}

fn write(run: &Workspace<'_>, title: &str, capture: &Capture, scene: &Scene) -> Result<(), Error> {
    let (mut manifest, payload) = pack(scene, title, median_depth(scene, run.level));
    let frames = frames(capture, scene)?;
    manifest.frames = frames.as_ref().map(|f| f.index.clone());
    let parts = Parts { manifest: &manifest, payload: Some(&payload.bytes), frames: frames.as_ref() };
    let html = page::compose(TEMPLATE, &parts, Compression::default())?;
    let path = run.path(VIEWER_FILE);
    let failed = |source| Error::Write { path: path.clone(), source };
    let mut file = AtomicFile::create(&path).map_err(failed)?;
    file.write_all(&html).map_err(failed)?;
    drop(html);
    file.sync().map_err(failed)?;
    let text =
        fs::read_to_string(file.temporary_path()).map_err(|source| Error::Read { path: path.clone(), source })?;
    let back = page::read(&text)?;
    if back.manifest != manifest || back.payload.as_ref() != Some(&payload.bytes) || back.frames != frames {
        return Err(OutputError::Verify { path, what: "the scene in it differs".to_owned() }.into());
    }
    file.commit().map_err(failed)
}

/// Title of the page: the name of the clip, or of the run where that is more telling.
pub fn title(folder: &Path, input: &str) -> String {
    let stem = Path::new(input).file_stem().and_then(|s| s.to_str());
    let own = folder.file_name().and_then(|s| s.to_str());
    let stem = stem.filter(|s| *s != CAPTURE_FOLDER && !s.starts_with("transforms"));
    stem.or(own).unwrap_or("scene").to_owned()
}
