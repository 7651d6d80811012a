//! `preview.mp4`: source, re-render and frozen time with a swinging camera, side by side; and
//! `poster.jpg`: a frame and its re-render, for overviews of many clips.

use super::stage;
use crate::run::record::FileRecord;
use crate::run::workspace::Workspace;
use m4_core::{
    Camera, Capture, Exposure, Progress, ResizeFilter, RgbImage, Scene, Silent, resize_rgb,
};
use m4_io::image::write_rgb;
use m4_io::video::Mp4Writer;
use m4_viewer::panels::{side_by_side, write_label};
use minute4d::hash::HashedCapture;
use minute4d::layout::{POSTER_FILE, PREVIEW_FILE};
use minute4d::observer::{RecordingObserver, check_stop};
use minute4d::render::{SWING_FRAMES, SceneRenderer, source_fps, swing};
use minute4d::settings::part_to_toml;
use minute4d::{Error, StageEvent};

/// Name of the stage.
pub const STAGE: &str = "preview";

/// Shortest clip, seconds; shorter ones are played again until they are this long.
const MIN_SECONDS: f64 = 4.0;

/// Makes the preview within a run, unless that was done before.
pub(crate) fn make(
    run: &mut Workspace<'_>,
    capture: &HashedCapture,
    scene: &Scene,
) -> Result<(), Error> {
    let config = part_to_toml(&run.job.settings.preview)?;
    let key = stage::key(STAGE, &[run.scene_hash(), &capture.hash, &config]);
    let Some(mut task) = run.task(STAGE, key, &[PREVIEW_FILE])? else {
        run.job.observer.stage(STAGE, StageEvent::Reused);
        return Ok(());
    };
    // A preview is computed again, so seconds of an earlier attempt do not count.
    task.seconds_before = 0.0;
    run.stage(STAGE, task, &[PREVIEW_FILE], |run, keeper| {
        draw(run, &capture.capture, scene, keeper)
    })
}

fn draw(
    run: &Workspace<'_>,
    capture: &Capture,
    scene: &Scene,
    keeper: &RecordingObserver<'_>,
) -> Result<(), Error> {
    let first = scene.source.first().ok_or_else(no_source)?;
    let size = panel_size(&first.camera, run.job.settings.preview.panel_px);
    let fps = source_fps(scene);
    let mut writer = Mp4Writer::create(&run.path(PREVIEW_FILE), 3 * size.0 + 2 * GAP, size.1, fps)?;

    let still = &scene.source[scene.source.len() / 2];
    let mut renderer = SceneRenderer::new(scene, run.level, run.gpu.as_ref(), keeper)?;
    let distance = renderer
        .painter()
        .median_depth(&still.camera, still.t)
        .unwrap_or(1.0);
    let n = scene.source.len();
    let rounds = ((MIN_SECONDS * fps / n as f64).ceil() as usize).clamp(1, 100);
    let total = n * rounds;
    // At least one whole swing, and a whole number of them, so that the clip loops.
    let swings = (total as f64 / SWING_FRAMES as f64).round().max(1.0);
    let period_frames = (total as f64 / swings).round() as usize;
    let cameras = swing(
        &still.camera.resized(size.0, size.1),
        distance,
        total,
        period_frames,
    );
    let mut panels = |i: usize, camera: &Camera| -> Result<RgbImage, Error> {
        check_stop(keeper, STAGE, true)?;
        let source = &scene.source[i % n];
        let photo = capture
            .frames
            .get(i % n)
            .and_then(|f| resize_rgb(&f.rgb, size.0, size.1, ResizeFilter::Triangle));
        let again = renderer.image(
            &source.camera.resized(size.0, size.1),
            source.t,
            &source.exposure,
        )?;
        let swung = renderer.image(camera, still.t, &Exposure::IDENTITY)?;
        keeper.update(STAGE, i + 1, total, "");
        let panels = [photo.as_ref(), Some(&again), Some(&swung)];
        let mut image = side_by_side(size, GAP, &panels);
        if size.0 >= 120 {
            for (i, label) in LABELS.iter().enumerate() {
                write_label(&mut image, i * (size.0 + GAP) + 6, 6, label);
            }
        }
        Ok(image)
    };
    for (i, camera) in cameras.iter().enumerate() {
        writer.push(panels(i, camera)?)?;
    }
    Ok(writer.finish()?)
}

fn no_source() -> Error {
    Error::internal("the scene has no source frames")
}

/// The size of a panel: at most `longest` pixels per side, both sides even.
fn panel_size(camera: &Camera, longest: usize) -> (usize, usize) {
    let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
    let scale = (longest.max(16) as f64 / w.max(h).max(1) as f64).min(1.0);
    let even = |side: usize| ((side as f64 * scale / 2.0).round() as usize * 2).max(2);
    (even(w), even(h))
}

/// Longest side of each of the two images, pixels: a page of a thousand posters stays under 50 MB.
const SIDE_PX: usize = 240;

/// Makes the poster of a run and notes it in the run's record. The frame is the one that the
/// preview freezes.
pub(crate) fn poster(
    run: &mut Workspace<'_>,
    capture: &Capture,
    scene: &Scene,
) -> Result<(), Error> {
    let frame = scene.source.len() / 2;
    let photo = capture.frames.get(frame);
    let (source, photo) = scene.source.get(frame).zip(photo).ok_or_else(no_source)?;
    let (width, height) = panel_size(&source.camera, SIDE_PX);
    let photo = resize_rgb(&photo.rgb, width, height, ResizeFilter::Triangle);
    let mut renderer = SceneRenderer::new(scene, run.level, None, &Silent)?;
    let again = renderer.image(
        &source.camera.resized(width, height),
        source.t,
        &source.exposure,
    )?;
    let both = side_by_side((width, height), 0, &[photo.as_ref(), Some(&again)]);
    let path = run.path(POSTER_FILE);
    write_rgb(&path, &both)?;
    let written = FileRecord::of(&path)?;
    run.record.files.insert(POSTER_FILE.to_owned(), written);
    Ok(())
}

/// Pixels between two panels.
const GAP: usize = 4;
/// The labels of the panels, where these are wide enough.
const LABELS: [&str; 3] = ["SOURCE", "RE-RENDER", "FROZEN TIME"];
