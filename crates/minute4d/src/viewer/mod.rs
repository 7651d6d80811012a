//! Shows scenes in a browser: `viewer.html` of a run, and the same page from a local server.
//!
//! [`stage`](self) writes the page as the last stage of a run. [`view()`] serves an existing scene and
//! shows every newer one; [`Broadcast`] does the same from within the training process.

mod broadcast;
mod file;
mod source;
mod view;

pub use broadcast::Broadcast;
pub(crate) use file::stage;
pub use file::title;
pub use view::{Viewing, view};

use crate::render::{Painter, source_fps};
use crate::{Category, Error};
use m4_core::{Capture, RgbImage, Scene};
use m4_kernels::SimdLevel;
use m4_viewer::page::PageError;
use m4_viewer::payload::{Payload, encode};
use m4_viewer::server::ServeError;
use m4_viewer::{About, FrameLimits, Frames, FramesError, Manifest, encode_frames};
use serde::{Deserialize, Serialize};

/// Name of the stage.
pub const STAGE: &str = "viewer";

/// Contents of the page of a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ViewerConfig {
    /// Write `viewer.html` at the end of a run.
    pub write: bool,
    /// The frames of the source, shown beside the scene.
    pub frames: FrameLimits,
}

impl Default for ViewerConfig {
    fn default() -> Self {
        Self { write: true, frames: FrameLimits::default() }
    }
}

/// Update interval of an open page during training; not part of the result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LiveConfig {
    /// Least seconds between two scenes. 2: a person does not follow more.
    pub every_s: f64,
    /// Most of the machine's time that scenes for the page may take; when they would take more there are
    /// fewer. 0.03: not noticed.
    pub share: f64,
}

impl Default for LiveConfig {
    fn default() -> Self {
        Self { every_s: 2.0, share: 0.03 }
    }
}

/// Why a scene cannot be shown in a browser.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ViewerError {
    /// The page of a scene.
    #[error(transparent)]
    Page(#[from] PageError),
    /// The frames in it.
    #[error(transparent)]
    Frames(#[from] FramesError),
    /// The server of the page.
    #[error(transparent)]
    Serve(#[from] ServeError),
}

impl ViewerError {
    /// Returns the category of the failure.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::Page(_) => Category::BadInput,
            Self::Frames(_) => Category::Internal,
            Self::Serve(_) => Category::TryAgain,
        }
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
fn frames(capture: &Capture, scene: &Scene, config: &ViewerConfig) -> Result<Option<Frames>, Error> {
    if capture.frames.len() != scene.source.len() {
        return Ok(None);
    }
    let images: Vec<&RgbImage> = capture.frames.iter().map(|f| &f.rgb).collect();
    Ok(encode_frames(&images, &config.frames)?)
}
