//! What is checked and said of a clip before anything is measured, and its frames and flows at the working size.

use super::config::DenseConfig;
use super::error::DenseError;
use super::estimate::each;
use super::flow::FlowPair;
use super::sources::Sources;
use super::user_masks;
use super::working::{WorkingFrame, fitting_side, working_size};
use crate::classical::reconstruction::{CameraMotion, SparseReconstruction};
use m4_core::{Camera, Mask, Progress, RgbImage};

/// Least side of a frame, pixels.
const LEAST_SIDE: usize = 32;
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
        user_masks::check(masks, frames.len())?;
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
        if let Some(found) = sources.mono.frames().filter(|&n| n != count) {
            let (what, expected) = ("depth", count);
            return Err(DenseError::Given { what, found, expected });
        }
        let resized: Vec<Camera> = sparse.cameras.iter().map(|c| c.resized(size.0, size.1)).collect();
        let one_lens = one_lens(&resized);
        if parallax && !one_lens {
            progress
                .warn("the focal length changes from frame to frame: dynamic objects get the depth of what they touch");
        }
        Ok(Self {
            size,
            parallax,
            one_lens,
        })
    }

    /// The frames at the working size.
    pub fn working(
        &self,
        frames: &[&RgbImage],
        sparse: &SparseReconstruction,
        progress: &dyn Progress,
    ) -> Result<Vec<WorkingFrame>, DenseError> {
        let (w, h) = self.size;
        each(frames.len(), "shrinking frames", progress, |i| {
            WorkingFrame::new(frames[i], &sparse.cameras[i], w, h)
        })
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
    let first = frames.first().ok_or(DenseError::NoFrames)?.size();
    if frames.len() != sparse.cameras.len() {
        return Err(DenseError::Count {
            frames: frames.len(),
            cameras: sparse.cameras.len(),
        });
    }
    for (frame, image) in frames.iter().enumerate() {
        let found = image.size();
        if found != first || found.0.min(found.1) < LEAST_SIDE {
            return Err(DenseError::Size {
                frame,
                found,
                expected: first,
                minimum: LEAST_SIDE,
            });
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
        return Err(DenseError::Camera { frame, what });
    }
    Ok(first)
}

/// Whether all frames were taken through the same lens, as bundle adjustment of bodies needs it.
fn one_lens(cameras: &[Camera]) -> bool {
    cameras.windows(2).all(|pair| pair[0].intrinsics == pair[1].intrinsics)
}
