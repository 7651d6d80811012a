//! `poster.jpg`: a small image of a frame and its re-render, for overviews of many clips.

use super::panel_size;
use crate::folder::{CAPTURE_FOLDER, SCENE_FILE};
use crate::record::{FileRecord, RUN_FILE, RunRecord};
use crate::render::SceneRenderer;
use crate::settings::Settings;
use crate::{Error, hash, train};
use m4_core::{Capture, CaptureFrame, Plane, ResizeFilter, Silent, resize_rgb};
use m4_io::image::write_rgb;
use m4_io::scene::safetensors;
use m4_kernels::SimdLevel;
use std::fs;
use std::path::{Path, PathBuf};

/// Name of the file in the folder of a run.
pub const POSTER_FILE: &str = "poster.jpg";
/// Longest side of each of the two images, pixels: a page of a thousand posters stays under 50 MB.
const SIDE_PX: usize = 240;

/// Makes the poster of a finished run of `input` and notes it in the run's record. The frame is the one that
/// the preview freezes.
///
/// # Errors
///
/// [`Error::Missing`] where the folder holds no run; [`Error`] where scene or capture cannot be read or nothing can be
/// written.
pub fn poster(run: &Path, input: &Path, settings: &Settings) -> Result<PathBuf, Error> {
    let mut record = RunRecord::read(run)?.ok_or_else(|| Error::Missing { what: RUN_FILE, path: run.to_path_buf() })?;
    // Warnings about the capture were given while the scene was made.
    let made = run.join(CAPTURE_FOLDER);
    let capture = train::read(if made.is_dir() { &made } else { input }, settings, &Silent)?;
    let scene = safetensors::read(&run.join(SCENE_FILE))?.scene;
    let frame = sharpest(&capture).min(scene.source.len().saturating_sub(1));
    let (Some(source), Some(photo)) = (scene.source.get(frame), capture.frames.get(frame)) else {
        return Err(Error::Internal { what: "the scene has no source frames".to_owned() });
    };
    let (width, height) = panel_size(&source.camera, SIDE_PX);
    let photo = resize_rgb(&photo.rgb, width, height, ResizeFilter::Triangle);
    let mut renderer = SceneRenderer::new(&scene, SimdLevel::detect()?, None)?;
    let again = renderer.image(&source.camera.resized(width, height), source.t, &source.exposure)?;
    let mut both = Plane::filled(2 * width, height, [0; 3]);
    for y in 0..height {
        let row = both.row_mut(y);
        if let Some(photo) = &photo {
            row[..width].copy_from_slice(photo.row(y));
        }
        row[width..].copy_from_slice(again.row(y));
    }
    let path = run.join(POSTER_FILE);
    write_rgb(&path, &both)?;
    let bytes = fs::metadata(&path).map_err(|source| Error::Read { path: path.clone(), source })?;
    let file = FileRecord { bytes: bytes.len(), blake3: hash::of_path(&path)? };
    record.files.insert(POSTER_FILE.to_owned(), file);
    record.write(run)?;
    Ok(path)
}

/// Stride of the sampled pixels, columns and rows.
const STEP: usize = 2;

/// Area and sharpness of the dynamic regions of a frame.
#[derive(Debug, Clone, Copy)]
struct RegionDetail {
    /// Pixels of the dynamic regions; all where there is no mask.
    count: usize,
    /// Mean squared brightness gradient over them.
    sharpness: f64,
}

/// Index of the frame in which the dynamic regions are sharpest (everything, where nothing moves). It is
/// one that shows at least three quarters of what the middle frame by that measure shows, away from
/// the ends of the clip, where the scene is seen least.
pub(super) fn sharpest(capture: &Capture) -> usize {
    let n = capture.frames.len();
    let inner: Vec<usize> = (n / 5..n - n / 5).collect();
    let all = looks(capture, &inner, true);
    let moves = all.iter().any(|look| look.count > 0);
    let looks = if moves { all } else { looks(capture, &inner, false) };
    let mut counts: Vec<usize> = looks.iter().map(|look| look.count).collect();
    counts.sort_unstable();
    let enough = counts.get(counts.len() / 2).map_or(0, |median| median * 3 / 4);
    let candidates = inner.iter().zip(&looks).filter(|(_, look)| look.count >= enough);
    // The first of equals: the choice must not depend on chance.
    let best = candidates.max_by(|(i, a), (j, b)| a.sharpness.total_cmp(&b.sharpness).then(j.cmp(i)));
    best.map_or(0, |(&i, _)| i)
}

fn looks(capture: &Capture, frames: &[usize], masked: bool) -> Vec<RegionDetail> {
    frames.iter().map(|&i| look(&capture.frames[i], masked)).collect()
}

fn look(frame: &CaptureFrame, masked: bool) -> RegionDetail {
    let (w, h) = frame.rgb.size();
    let brightness = |x: usize, y: usize| frame.rgb[(x, y)].iter().map(|&c| f64::from(c)).sum::<f64>();
    let counts = |x: usize, y: usize| match frame.mask.as_ref().filter(|_| masked) {
        Some(mask) => mask.at(x * mask.size().0 / w, y * mask.size().1 / h),
        None => true,
    };
    let (mut sum, mut count) = (0.0, 0usize);
    for y in (0..h.saturating_sub(1)).step_by(STEP) {
        for x in (0..w.saturating_sub(1)).step_by(STEP) {
            if counts(x, y) {
                let here = brightness(x, y);
                sum += (brightness(x + 1, y) - here).powi(2) + (brightness(x, y + 1) - here).powi(2);
                count += 1;
            }
        }
    }
    let sharpness = sum / count.max(1) as f64;
    RegionDetail { count, sharpness }
}

#[cfg(test)]
mod tests {
    use super::sharpest;
    use m4_core::{Camera, Capture, CaptureFrame, CompactMask, Intrinsics, Plane, Se3};

    #[test]
    fn frame_with_most_dynamic_detail_wins() {
        let frame = |i: usize| CaptureFrame {
            name: i.to_string(),
            camera: Camera { intrinsics: Intrinsics::centred(32, 24, 30.0), c2w: Se3::identity() },
            t: i as f64,
            // Stripes to the left in frame 6; stronger ones to the right, where nothing moves, in frame 4; and
            // in frame 3, where next to nothing is masked.
            rgb: Plane::from_fn(32, 24, |x, _| {
                let striped = if i == 6 { x < 16 } else { i == 3 || i == 4 && x >= 16 };
                let strength = if i == 6 { 100 } else { 255 };
                [if striped && x % 2 == 0 { strength } else { 0 }; 3]
            }),
            depth: None,
            mask: Some(CompactMask::from_fn(32, 24, |x, _| x < if i == 3 { 2 } else { 16 })),
            motion: None,
            instances: None,
            camera_index: None,
        };
        let capture = Capture {
            frames: (0..10).map(frame).collect(),
            time_frames: 10,
            duration_s: None,
            metric: false,
            tracks: None,
        };
        assert_eq!(sharpest(&capture), 6);
    }
}
