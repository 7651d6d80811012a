//! `preview.mp4`: source, re-render and frozen time with a swinging camera, side by side; and
//! `poster.jpg`: a frame and its re-render, for overviews of many clips.

use super::stage;
use crate::run::record::FileRecord;
use crate::run::workspace::Workspace;
use m4_core::{
    Camera, Capture, Exposure, Plane, Progress, ResizeFilter, RgbImage, Scene, Silent, resize_rgb,
};
use m4_io::image::write_rgb;
use m4_io::video::Mp4Writer;
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
        Ok(side_by_side(
            size,
            [photo.as_ref(), Some(&again), Some(&swung)],
        ))
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
    let mut both = Plane::filled(2 * width, height, [0; 3]);
    for y in 0..height {
        let row = both.row_mut(y);
        if let Some(photo) = &photo {
            row[..width].copy_from_slice(photo.row(y));
        }
        row[width..].copy_from_slice(again.row(y));
    }
    let path = run.path(POSTER_FILE);
    write_rgb(&path, &both)?;
    let written = FileRecord::of(&path)?;
    run.record.files.insert(POSTER_FILE.to_owned(), written);
    Ok(())
}

/// Pixels between two panels.
const GAP: usize = 4;
/// The labels of the panels.
const LABELS: [&str; 3] = ["SOURCE", "RE-RENDER", "FROZEN TIME"];

/// Places panels of the same size side by side, with labels if they are wide enough; black where
/// there is none.
fn side_by_side((width, height): (usize, usize), panels: [Option<&RgbImage>; 3]) -> RgbImage {
    let mut out = Plane::filled(3 * width + 2 * GAP, height, [0; 3]);
    for (i, panel) in panels.into_iter().enumerate() {
        let left = i * (width + GAP);
        if let Some(panel) = panel {
            for y in 0..height {
                out.row_mut(y)[left..left + width].copy_from_slice(panel.row(y));
            }
        }
        if width >= 120 {
            write_label(&mut out, left + 6, 6, LABELS[i]);
        }
    }
    out
}

/// Columns and rows of a letter.
const LETTER: (usize, usize) = (5, 7);
/// Pixels a dot.
const DOT: usize = 2;

/// The rows of a letter, most significant of five bits to the left; `None` draws as a space.
fn rows(letter: char) -> Option<[u8; 7]> {
    Some(match letter {
        'C' => [0x0e, 0x11, 0x10, 0x10, 0x10, 0x11, 0x0e],
        'D' => [0x1e, 0x11, 0x11, 0x11, 0x11, 0x11, 0x1e],
        'E' => [0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x1f],
        'F' => [0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x10],
        'I' => [0x0e, 0x04, 0x04, 0x04, 0x04, 0x04, 0x0e],
        'M' => [0x11, 0x1b, 0x15, 0x15, 0x11, 0x11, 0x11],
        'N' => [0x11, 0x19, 0x15, 0x13, 0x11, 0x11, 0x11],
        'O' => [0x0e, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e],
        'R' => [0x1e, 0x11, 0x11, 0x1e, 0x14, 0x12, 0x11],
        'S' => [0x0f, 0x10, 0x10, 0x0e, 0x01, 0x01, 0x1e],
        'T' => [0x1f, 0x04, 0x04, 0x04, 0x04, 0x04, 0x04],
        'U' => [0x11, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e],
        'Z' => [0x1f, 0x01, 0x02, 0x04, 0x08, 0x10, 0x1f],
        '-' => [0x00, 0x00, 0x00, 0x1f, 0x00, 0x00, 0x00],
        _ => return None,
    })
}

/// Writes `text` in white on a darkened strip whose top left corner is at `(x, y)`; what does not
/// fit is cut off.
fn write_label(image: &mut RgbImage, x: usize, y: usize, text: &str) {
    let advance = (LETTER.0 + 1) * DOT;
    let strip = (
        text.chars().count() * advance + 2 * DOT,
        (LETTER.1 + 2) * DOT,
    );
    let (width, height) = image.size();
    for v in y..(y + strip.1).min(height) {
        for u in x..(x + strip.0).min(width) {
            image[(u, v)] = image[(u, v)].map(|c| c / 3);
        }
    }
    for (i, letter) in text.chars().enumerate() {
        let Some(rows) = rows(letter) else { continue };
        for (r, bits) in rows.iter().enumerate() {
            for c in (0..LETTER.0).filter(|c| bits >> (LETTER.0 - 1 - c) & 1 == 1) {
                let (left, top) = (x + DOT + i * advance + c * DOT, y + DOT + r * DOT);
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    if left + dx < width && top + dy < height {
                        image[(left + dx, top + dy)] = [255; 3];
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{GAP, LABELS, rows, side_by_side, write_label};
    use m4_core::Plane;

    #[test]
    fn panels_are_side_by_side() {
        let [red, blue] = [[255, 0, 0], [0, 0, 255]].map(|c| Plane::filled(8, 6, c));
        let out = side_by_side((8, 6), [Some(&red), None, Some(&blue)]);
        assert_eq!(out.size(), (24 + 2 * GAP, 6));
        assert_eq!(
            (out[(0, 0)], out[(12, 3)], out[(31, 5)]),
            ([255, 0, 0], [0; 3], [0, 0, 255])
        );
        assert_eq!(out[(9, 2)], [0; 3]);
    }

    #[test]
    fn every_letter_exists_and_is_cut_off_at_the_border() {
        let mut image = Plane::filled(40, 30, [90; 3]);
        write_label(&mut image, 0, 0, "T");
        assert_eq!(
            (image[(2, 2)], image[(2, 10)], image[(6, 10)]),
            ([255; 3], [30; 3], [255; 3])
        );
        assert_eq!(image[(39, 29)], [90; 3]);
        write_label(&mut image, 36, 26, "FROZEN TIME");
        for letter in LABELS.concat().chars().filter(|c| *c != ' ') {
            assert!(rows(letter).is_some(), "{letter}");
        }
    }
}
