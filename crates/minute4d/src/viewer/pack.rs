//! Packs a scene into the data of the page.

use super::ViewerConfig;
use crate::Error;
use crate::render::{Painter, source_fps};
use m4_core::{Capture, RgbImage, Scene};
use m4_kernels::SimdLevel;
use m4_viewer::payload::{Payload, encode};
use m4_viewer::{About, Frames, Manifest, encode_frames};

/// The splats for the page, and their metadata. `median_depth`: of what the middle camera
/// sees, world units.
pub(super) fn pack(scene: &Scene, title: &str, median_depth: f64) -> (Manifest, Payload) {
    let payload = encode(scene, median_depth);
    let about = About {
        title,
        median_depth,
        fps: source_fps(scene),
    };
    (Manifest::new(scene, &payload, &about), payload)
}

/// Median z-depth of the view of the middle camera, world units; 1 for an empty view.
pub(super) fn median_depth(scene: &Scene, level: SimdLevel) -> f64 {
    let middle = scene.source.get(scene.source.len() / 2);
    let depth = middle.and_then(|s| Painter::new(scene, level).median_depth(&s.camera, s.t));
    depth.unwrap_or(1.0)
}

/// The frames of a capture for the page of a scene; `None` where they are not those of its cameras.
pub(super) fn frames(capture: &Capture, scene: &Scene, config: &ViewerConfig) -> Result<Option<Frames>, Error> {
    if capture.frames.len() != scene.source.len() {
        return Ok(None);
    }
    let images: Vec<&RgbImage> = capture.frames.iter().map(|f| &f.rgb).collect();
    Ok(encode_frames(&images, &config.frames)?)
}
