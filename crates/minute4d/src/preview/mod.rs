//! `preview.mp4`: source, re-render and frozen time with a swinging camera, side by side.

mod panels;
mod poster;

pub use poster::{POSTER_FILE, poster};

use crate::folder::PREVIEW_FILE;
use crate::render::{SceneRenderer, SwingConfig, source_fps, swing};
use crate::settings::part_to_toml;
use crate::stage::RecordingObserver;
use crate::workspace::{Task, Workspace};
use crate::{Error, StageEvent, hash};
use m4_core::{Camera, Capture, Exposure, Progress, ResizeFilter, Scene, resize_rgb};
use m4_io::video::Mp4Writer;
use panels::Panels;
use serde::{Deserialize, Serialize};

/// Name of the stage.
pub const STAGE: &str = "preview";

/// Shape of the clip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PreviewConfig {
    /// Longest side of each of the three panels, pixels. 480: three fit on a full-HD screen.
    pub panel_px: usize,
    /// Name the panels in the image.
    pub labels: bool,
    /// Shortest clip, seconds; shorter ones are played again until they are this long. 4: one swing.
    pub min_seconds: f64,
    /// The camera of the third panel.
    pub swing: SwingConfig,
}

impl Default for PreviewConfig {
    fn default() -> Self {
        Self { panel_px: 480, labels: true, min_seconds: 4.0, swing: SwingConfig::default() }
    }
}

/// Makes the preview within a run, unless that was done before.
pub(crate) fn stage(run: &mut Workspace<'_>, capture: &Capture, scene: &Scene) -> Result<(), Error> {
    let scene_hash = run.record.files.get(crate::folder::SCENE_FILE).map_or("", |f| f.blake3.as_str());
    let config = part_to_toml(&run.job.settings.preview)?;
    let key = hash::of_parts(&[STAGE, env!("CARGO_PKG_VERSION"), scene_hash, &hash::of_capture(capture), &config]);
    let task = match run.task(STAGE, &key, &[PREVIEW_FILE])? {
        Task::Reuse => {
            run.job.observer.stage(STAGE, StageEvent::Reused);
            return Ok(());
        }
        // A preview is computed again, so seconds of an earlier attempt do not count.
        Task::Work { because, .. } => (because, 0.0),
    };
    run.stage(STAGE, key, task, &[PREVIEW_FILE], |run, keeper| draw(run, capture, scene, keeper))
}

fn draw(run: &Workspace<'_>, capture: &Capture, scene: &Scene, keeper: &RecordingObserver<'_>) -> Result<(), Error> {
    let config = &run.job.settings.preview;
    let Some(first) = scene.source.first() else {
        return Err(Error::Internal { what: "the scene has no source frames".to_owned() });
    };
    let size = panel_size(&first.camera, config.panel_px);
    let panels = Panels::new(size, config.labels);
    let fps = source_fps(scene);
    let mut writer = Mp4Writer::create(&run.path(PREVIEW_FILE), panels.size().0, panels.size().1, fps)?;

    let frozen = poster::sharpest(capture).min(scene.source.len() - 1);
    let still = &scene.source[frozen];
    let mut renderer = SceneRenderer::new(scene, run.level, run.gpu.as_ref())?;
    let distance = renderer.painter().median_depth(&still.camera, still.t).unwrap_or(1.0);
    let n = scene.source.len();
    let rounds = ((config.min_seconds * fps / n as f64).ceil() as usize).clamp(1, 100);
    let total = n * rounds;
    // At least one whole swing, and a whole number of them, so that the clip loops.
    let swings = (total as f64 / config.swing.period_frames.max(2) as f64).round().max(1.0);
    let swing_config = SwingConfig { period_frames: (total as f64 / swings).round() as usize, ..config.swing };
    let cameras = swing(&still.camera.resized(size.0, size.1), distance, total, &swing_config);
    for (i, camera) in cameras.iter().enumerate() {
        if keeper.cancelled() {
            return Err(Error::Stopped { stage: STAGE, saved: true });
        }
        let source = &scene.source[i % n];
        let photo = capture.frames.get(i % n).and_then(|f| resize_rgb(&f.rgb, size.0, size.1, ResizeFilter::Triangle));
        let again = renderer.image(&source.camera.resized(size.0, size.1), source.t, &source.exposure)?;
        let swung = renderer.image(camera, still.t, &Exposure::IDENTITY)?;
        writer.push(&panels.compose([photo.as_ref(), Some(&again), Some(&swung)]))?;
        keeper.update(STAGE, i + 1, total, "");
    }
    writer.finish()?;
    Ok(())
}

/// The size of a panel: at most `longest` pixels per side, both sides even.
fn panel_size(camera: &Camera, longest: usize) -> (usize, usize) {
    let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
    let scale = (longest.max(16) as f64 / w.max(h).max(1) as f64).min(1.0);
    let even = |side: usize| ((side as f64 * scale / 2.0).round() as usize * 2).max(2);
    (even(w), even(h))
}
