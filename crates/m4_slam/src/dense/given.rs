//! What the caller knows already.

use super::DenseError;
use m4_scene::{DepthMap, Mask};

/// Masks and depth that are taken as they are. Of any size; they are read at the nearest pixel.
#[derive(Debug, Clone, Copy, Default)]
pub struct Given<'a> {
    /// One a frame: above 0 where something moves. No motion is looked for then.
    pub masks: Option<&'a [Mask]>,
    /// One a frame: z-depth in the unit of the cameras, 0 or NaN where unknown. Where it is known nothing is measured.
    pub depth: Option<&'a [DepthMap]>,
}

impl Given<'_> {
    /// Rejects what does not fit the clip.
    pub(super) fn check(&self, frames: usize) -> Result<(), DenseError> {
        let given = [
            ("masks", self.masks.map(<[_]>::len)),
            ("depth", self.depth.map(<[_]>::len)),
        ];
        for (what, found) in given {
            if let Some(found) = found.filter(|&n| n != frames) {
                let expected = frames;
                return Err(DenseError::Given { what, found, expected });
            }
        }
        Ok(())
    }

    /// The given mask of a frame at the working size, 255 for moving.
    pub(super) fn mask(&self, i: usize, width: usize, height: usize) -> Option<Vec<u8>> {
        let mask = &self.masks?[i];
        let at = nearest(mask.size(), width, height);
        Some(
            (0..width * height)
                .map(|p| if mask[at(p)] > 0 { 255 } else { 0 })
                .collect(),
        )
    }

    /// The given disparity of a frame at the working size, 0 where unknown.
    pub(super) fn disparity(&self, i: usize, width: usize, height: usize) -> Option<Vec<f32>> {
        let depth = &self.depth?[i];
        let at = nearest(depth.size(), width, height);
        let one = |p: usize| {
            let z = depth[at(p)];
            if z > 0.0 && z.is_finite() { 1.0 / z } else { 0.0 }
        };
        Some((0..width * height).map(one).collect())
    }
}

/// The pixel of a plane of size `from` at the centre of pixel `p` of one of `width` x `height`.
fn nearest(from: (usize, usize), width: usize, height: usize) -> impl Fn(usize) -> (usize, usize) {
    move |p| {
        let (x, y) = (p % width, p / width);
        ((2 * x + 1) * from.0 / (2 * width), (2 * y + 1) * from.1 / (2 * height))
    }
}
