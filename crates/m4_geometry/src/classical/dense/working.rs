//! A clip at the working size, and what is checked before anything is measured.

use super::sources::{DenseConfig, DenseError, Sources};
use crate::FrameRate;
use crate::classical::{CameraMotion, SparseReconstruction, Track, check_count};
use crate::flow::FlowPair;
use crate::resample::working_size;
use m4_core::{Camera, Mask, Progress, RgbImage};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What a pixel of the working size takes in a frame while the clip is worked on, bytes: 81 were
/// measured with the planes of this module (docs/geometry-log.md, "Memory"), rounded up.
const BYTES_PER_PIXEL: usize = 85;
/// Sides below this show too little to work on.
const LEAST_SIDE: usize = 160;
/// Least side of a frame, pixels.
const LEAST_FRAME_SIDE: usize = 32;

/// A clip with masks, disparity and flow; lists are by frame, planes `[height][width]` at the
/// working size.
pub(super) struct WorkingClip<'a> {
    pub width: usize,
    pub height: usize,
    pub rate: FrameRate,
    pub cameras: &'a [Camera],
    /// Above 0 in dynamic regions.
    pub dynamic: &'a [Vec<u8>],
    /// Disparity of static regions, continued behind dynamic ones; for tracks, of everything.
    pub disparity: &'a [Vec<f32>],
    /// Between neighbouring frames.
    pub flows: &'a [FlowPair],
}

/// A synthetic clip.
#[cfg(test)]
pub(super) struct ClipData {
    pub size: (usize, usize),
    pub cameras: Vec<Camera>,
    pub dynamic: Vec<Vec<u8>>,
    pub disparity: Vec<Vec<f32>>,
    pub flows: Vec<FlowPair>,
}

#[cfg(test)]
impl ClipData {
    pub fn clip(&self) -> WorkingClip<'_> {
        let (width, height) = self.size;
        let Self {
            cameras,
            dynamic,
            disparity,
            flows,
            ..
        } = self;
        WorkingClip {
            width,
            height,
            rate: FrameRate::FILM,
            cameras,
            dynamic,
            disparity,
            flows,
        }
    }
}

/// The longest side, at most `side`, at which `frames` frames of `width` x `height` stay within
/// `memory_mb` megabytes; not less than [`LEAST_SIDE`].
fn fitting_side(
    width: usize,
    height: usize,
    side: usize,
    frames: usize,
    memory_mb: usize,
) -> usize {
    let (w, h) = working_size(width, height, side);
    let wanted = (w * h * frames.max(1) * BYTES_PER_PIXEL) as f64;
    let share = (memory_mb as f64 * 1e6 / wanted).min(1.0).sqrt();
    ((w.max(h) as f64 * share) as usize)
        .max(LEAST_SIDE)
        .min(side)
}

/// What is known of a clip before anything is measured.
pub(super) struct Ground {
    /// Width and height at the working size.
    pub size: (usize, usize),
    /// At the working size.
    pub cameras: Vec<Camera>,
    /// Whether all frames were taken through the same lens, as bundle adjustment of rigid objects
    /// needs it.
    pub one_lens: bool,
}

impl Ground {
    /// Checks everything and warns of what is doubtful.
    pub fn of(
        frames: &[&RgbImage],
        sparse: &SparseReconstruction,
        sources: &Sources<'_>,
        masks: Option<&[Mask]>,
        config: &DenseConfig,
        progress: &dyn Progress,
    ) -> Result<Self, DenseError> {
        let wanted = config.working_side_px;
        if !(64..=2048).contains(&wanted) {
            let (name, value) = ("dense.working_side_px", wanted as f64);
            return Err(DenseError::Setting {
                name,
                value,
                range: "64 to 2048",
            });
        }
        let count = frames.len();
        check_count("masks", masks.map_or(count, <[_]>::len), count).map_err(DenseError::Input)?;
        let (full_w, full_h) = check(frames, sparse)?;
        let side = fitting_side(full_w, full_h, wanted, count, config.memory_mb);
        if side < wanted.min(full_w.max(full_h)) {
            progress.warn(&format!(
                "{count} frames are too many for full detail within {} MB: depth and masks are made at {side} px instead of {wanted} \
                 (raise dense.memory_mb, or cut the clip)",
                config.memory_mb
            ));
        }
        let size = working_size(full_w, full_h, side);
        let parallax = sparse.camera_motion == CameraMotion::Parallax;
        if !parallax {
            progress.warn(
                "the camera hardly moves, so depth cannot be measured: the static background is placed at distance 1 and dynamic \
                 parts in layers in front of it; views from the side will look flat (film again while walking sideways)",
            );
        }
        if let Some(mono) = sources.mono {
            check_count("depth maps", mono.maps.len(), count).map_err(DenseError::Input)?;
            if let Some(frame) = mono.maps.iter().position(|map| map.data().is_empty()) {
                return Err(DenseError::Input(format!(
                    "the depth map of frame {frame} is empty; give one of the shape of the frame"
                )));
            }
        }
        let cameras: Vec<Camera> = sparse
            .cameras
            .iter()
            .map(|c| c.resized(size.0, size.1))
            .collect();
        let one_lens = cameras
            .windows(2)
            .all(|pair| pair[0].intrinsics == pair[1].intrinsics);
        if parallax && !one_lens {
            progress
                .warn("the focal length changes from frame to frame: dynamic objects get the depth of what they touch");
        }
        Ok(Self {
            size,
            cameras,
            one_lens,
        })
    }
}

fn check(
    frames: &[&RgbImage],
    sparse: &SparseReconstruction,
) -> Result<(usize, usize), DenseError> {
    let refused = |what: String| Err(DenseError::Input(what));
    let Some(first) = frames.first().map(|frame| frame.size()) else {
        return refused("there are no frames; give at least one".to_owned());
    };
    let (count, cameras) = (frames.len(), sparse.cameras.len());
    if count != cameras {
        return refused(format!(
            "{count} frames but {cameras} cameras; the reconstruction must be of the same frames"
        ));
    }
    for (frame, image) in frames.iter().enumerate() {
        let (w, h) = image.size();
        if (w, h) != first || w.min(h) < LEAST_FRAME_SIDE {
            return refused(format!(
                "frame {frame} is {w}x{h} where {}x{} was expected; all frames must have one size, at least {LEAST_FRAME_SIDE} px per \
                 side",
                first.0, first.1
            ));
        }
    }
    for (frame, camera) in sparse.cameras.iter().enumerate() {
        let (k, pose) = (&camera.intrinsics, &camera.c2w);
        let finite = |v: &[f64]| v.iter().all(|v| v.is_finite());
        let what = if k.width == 0 || k.height == 0 {
            "an empty image"
        } else if !finite(&[k.fx, k.fy, k.cx, k.cy]) || k.fx <= 0.0 || k.fy <= 0.0 {
            "no valid focal length"
        } else if !finite(pose.rotation.as_slice()) || !finite(pose.translation.as_slice()) {
            "a pose that is not finite"
        } else {
            continue;
        };
        return refused(format!(
            "the camera of frame {frame} has {what}; the reconstruction is damaged, make it again"
        ));
    }
    Ok(first)
}

/// Runs `f` for every frame in parallel, in order of frames, with progress.
pub(super) fn each<T: Send>(
    count: usize,
    phase: &'static str,
    progress: &dyn Progress,
    f: impl Fn(usize) -> T + Sync,
) -> Result<Vec<T>, DenseError> {
    let done = AtomicUsize::new(0);
    let one = |i: usize| {
        if progress.cancelled() {
            return None;
        }
        let out = f(i);
        progress.update(phase, done.fetch_add(1, Ordering::Relaxed) + 1, count, "");
        Some(out)
    };
    let all: Option<Vec<T>> = (0..count).into_par_iter().map(one).collect();
    all.ok_or(DenseError::Cancelled { phase })
}

/// The same for what may fail; the error of the first frame that does.
pub(super) fn try_each<T: Send>(
    count: usize,
    phase: &'static str,
    progress: &dyn Progress,
    f: impl Fn(usize) -> Result<T, DenseError> + Sync,
) -> Result<Vec<T>, DenseError> {
    each(count, phase, progress, f)?.into_iter().collect()
}

/// Every observation of every track in the image: frame, pixel at the working size, and track.
pub(super) fn observed(
    sparse: &SparseReconstruction,
    width: usize,
    height: usize,
) -> impl Iterator<Item = (usize, usize, &Track)> {
    let pixel = move |frame: usize, seen: &[f32; 2]| {
        let size = &sparse.cameras.get(frame)?.intrinsics;
        let x = (f64::from(seen[0]) + 0.5) * width as f64 / size.width as f64;
        let y = (f64::from(seen[1]) + 0.5) * height as f64 / size.height as f64;
        let inside = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
        inside.then(|| y as usize * width + x as usize)
    };
    sparse.tracks.iter().flat_map(move |track| {
        let observations = (track.first_frame..).zip(&track.observations);
        observations
            .filter_map(move |(frame, position)| Some((frame, pixel(frame, position)?, track)))
    })
}

/// The pixel nearest to a place, clamped to the image.
pub(super) fn nearest_pixel(width: usize, height: usize, x: f32, y: f32) -> usize {
    ((y + 0.5).max(0.0) as usize).min(height - 1) * width
        + ((x + 0.5).max(0.0) as usize).min(width - 1)
}

/// The pixel nearest to a place, if that is in the image.
pub(super) fn pixel_at(width: usize, height: usize, x: f32, y: f32) -> Option<usize> {
    let (x, y) = (x + 0.5, y + 0.5);
    let inside = x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32;
    inside.then(|| y as usize * width + x as usize)
}

/// The mask at the working size, 255 in dynamic regions, read at the nearest pixel.
pub(super) fn mask_at_size(mask: &Mask, width: usize, height: usize) -> Vec<u8> {
    let at = nearest(mask.size(), width, height);
    (0..width * height)
        .map(|p| if mask[at(p)] > 0 { 255 } else { 0 })
        .collect()
}

/// The pixel of a plane of size `from` at the centre of pixel `p` of one of `width` x `height`.
pub(super) fn nearest(
    from: (usize, usize),
    width: usize,
    height: usize,
) -> impl Fn(usize) -> (usize, usize) {
    move |p| {
        let (x, y) = (p % width, p / width);
        (
            (2 * x + 1) * from.0 / (2 * width),
            (2 * y + 1) * from.1 / (2 * height),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::fitting_side;

    #[test]
    fn long_clips_are_worked_on_at_a_smaller_size() {
        assert_eq!(fitting_side(1920, 1080, 480, 96, 4096), 480);
        let long = fitting_side(1920, 1080, 480, 1500, 4096);
        assert!((160..300).contains(&long), "{long}");
        let bytes = long * (long * 1080 / 1920) * 1500 * super::BYTES_PER_PIXEL;
        assert!(bytes <= 4_100_000_000, "{bytes}");
        assert_eq!(fitting_side(1920, 1080, 480, 1_000_000, 4096), 160);
    }
}
