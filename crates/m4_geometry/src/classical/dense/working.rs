//! Frames, flow and masks of the caller at the working size, and what is checked before anything is measured.

use super::error::{DenseError, check_count};
use super::estimate::each;
use super::flow::{FlowImage, FlowPair};
use super::sources::{DenseConfig, Sources};
use crate::classical::reconstruction::{CameraMotion, SparseReconstruction};
use crate::resample::rgb_and_grey;
use m4_core::{Camera, Mask, Progress, RgbImage};

/// One frame at the working size.
#[derive(Debug, Clone)]
pub(super) struct WorkingFrame {
    pub width: usize,
    pub height: usize,
    /// `[height][width][3]`, 0..255.
    pub rgb: Vec<[u8; 3]>,
    /// `[height][width]`, 0..255.
    pub grey: Vec<f32>,
    /// The frame's camera for this size.
    pub camera: Camera,
}

/// The size whose longest side is `side`, or the size itself if it is smaller.
pub(crate) fn working_size(width: usize, height: usize, side: usize) -> (usize, usize) {
    let longest = width.max(height);
    if longest <= side {
        return (width, height);
    }
    let scaled = |n: usize| ((n * side + longest / 2) / longest).max(1);
    (scaled(width), scaled(height))
}

/// What a pixel of the working size takes in a frame while the clip is worked on, bytes: 81 were measured with the
/// planes of this module (docs/geometry.md), rounded up.
const BYTES_PER_PIXEL: usize = 85;
/// Sides below this show too little to work on.
const LEAST_SIDE: usize = 160;

/// The longest side, at most `side`, at which `frames` frames of `width` x `height` stay within `memory_mb` megabytes; not less than
/// 160 pixels.
pub(super) fn fitting_side(width: usize, height: usize, side: usize, frames: usize, memory_mb: usize) -> usize {
    let (w, h) = working_size(width, height, side);
    let wanted = (w * h * frames.max(1) * BYTES_PER_PIXEL) as f64;
    let share = (memory_mb as f64 * 1e6 / wanted).min(1.0).sqrt();
    ((w.max(h) as f64 * share) as usize).max(LEAST_SIDE).min(side)
}

impl WorkingFrame {
    pub fn new(image: &RgbImage, camera: &Camera, width: usize, height: usize) -> Self {
        let (rgb, grey) = rgb_and_grey(image, width, height);
        Self { width, height, rgb, grey, camera: camera.resized(width, height) }
    }

    pub fn flow_image(&self) -> FlowImage<'_> {
        FlowImage { width: self.width, height: self.height, rgb: &self.rgb, grey: &self.grey }
    }
}

/// Least side of a frame, pixels.
const LEAST_FRAME_SIDE: usize = 32;
/// What is known of a clip before anything is measured.
pub(super) struct Ground {
    /// Width and height at the working size.
    pub size: (usize, usize),
    pub parallax: bool,
    /// Whether all frames were taken through the same lens, as bundle adjustment of bodies needs it.
    pub one_lens: bool,
}

impl Ground {
    /// Checks everything and says what is doubtful.
    pub fn of(
        frames: &[&RgbImage],
        sparse: &SparseReconstruction,
        sources: &Sources<'_>,
        masks: Option<&[Mask]>,
        config: &DenseConfig,
        progress: &dyn Progress,
    ) -> Result<Self, DenseError> {
        config.check()?;
        check_count("masks", masks.map_or(frames.len(), <[_]>::len), frames.len())?;
        let (full_w, full_h) = check(frames, sparse)?;
        let count = frames.len();
        let side = fitting_side(full_w, full_h, config.working_side_px, count, config.memory_mb);
        if side < config.working_side_px.min(full_w.max(full_h)) {
            progress.warn(&format!(
                "{count} frames are too many for full detail within {} MB: depth and masks are made at {side} px instead of {} (raise \
                 dense.memory_mb, or cut the clip)",
                config.memory_mb, config.working_side_px
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
        check_count("depth", sources.mono.frames().unwrap_or(count), count)?;
        let resized: Vec<Camera> = sparse.cameras.iter().map(|c| c.resized(size.0, size.1)).collect();
        let one_lens = one_lens(&resized);
        if parallax && !one_lens {
            progress
                .warn("the focal length changes from frame to frame: dynamic objects get the depth of what they touch");
        }
        Ok(Self { size, parallax, one_lens })
    }

    /// The frames at the working size.
    pub fn working(
        &self,
        frames: &[&RgbImage],
        sparse: &SparseReconstruction,
        progress: &dyn Progress,
    ) -> Result<Vec<WorkingFrame>, DenseError> {
        let (w, h) = self.size;
        each(frames.len(), "shrinking frames", progress, |i| WorkingFrame::new(frames[i], &sparse.cameras[i], w, h))
    }

    /// Flow between neighbouring frames.
    pub fn flows(
        &self,
        working: &[WorkingFrame],
        sources: &Sources<'_>,
        progress: &dyn Progress,
    ) -> Result<Vec<FlowPair>, DenseError> {
        let flows = each(working.len() - 1, "computing flow", progress, |i| {
            FlowPair::new(&working[i], &working[i + 1], sources.flow)
                .map_err(|source| DenseError::Flow { frame: i, source })
        })?;
        flows.into_iter().collect()
    }
}

fn check(frames: &[&RgbImage], sparse: &SparseReconstruction) -> Result<(usize, usize), DenseError> {
    let refused = |what: String| Err(DenseError::Input(what));
    let Some(first) = frames.first().map(|frame| frame.size()) else {
        return refused("there are no frames; give at least one".to_owned());
    };
    let cameras = sparse.cameras.len();
    if frames.len() != cameras {
        return refused(format!(
            "{} frames but {cameras} cameras; the reconstruction must be of the same frames",
            frames.len()
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
        let k = &camera.intrinsics;
        let finite = |v: &[f64]| v.iter().all(|v| v.is_finite());
        let pose = &camera.c2w;
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

/// Whether all frames were taken through the same lens, as bundle adjustment of bodies needs it.
fn one_lens(cameras: &[Camera]) -> bool {
    cameras.windows(2).all(|pair| pair[0].intrinsics == pair[1].intrinsics)
}

/// The mask at the working size, 255 in dynamic regions, read at the nearest pixel.
pub(super) fn mask_at_size(mask: &Mask, width: usize, height: usize) -> Vec<u8> {
    let at = nearest(mask.size(), width, height);
    (0..width * height).map(|p| if mask[at(p)] > 0 { 255 } else { 0 }).collect()
}

/// The pixel of a plane of size `from` at the centre of pixel `p` of one of `width` x `height`.
pub(super) fn nearest(from: (usize, usize), width: usize, height: usize) -> impl Fn(usize) -> (usize, usize) {
    move |p| {
        let (x, y) = (p % width, p / width);
        ((2 * x + 1) * from.0 / (2 * width), (2 * y + 1) * from.1 / (2 * height))
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
