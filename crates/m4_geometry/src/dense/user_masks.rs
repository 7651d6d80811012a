//! What the caller knows already.

use super::DenseError;
use m4_core::Mask;

/// Masks of the user, taken as they are. Of any size; they are read at the nearest pixel. Known depth has a source of its
/// own: [`super::SensorDepth`].
#[derive(Debug, Clone, Copy, Default)]
pub struct UserMasks<'a> {
    /// One per frame: above 0 in dynamic regions. Motion segmentation is skipped then.
    pub masks: Option<&'a [Mask]>,
}

impl UserMasks<'_> {
    /// Rejects what does not fit the clip.
    pub(super) fn check(&self, frames: usize) -> Result<(), DenseError> {
        if let Some(found) = self.masks.map(<[_]>::len).filter(|&n| n != frames) {
            let (what, expected) = ("masks", frames);
            return Err(DenseError::Given { what, found, expected });
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
}

/// The pixel of a plane of size `from` at the centre of pixel `p` of one of `width` x `height`.
pub(super) fn nearest(from: (usize, usize), width: usize, height: usize) -> impl Fn(usize) -> (usize, usize) {
    move |p| {
        let (x, y) = (p % width, p / width);
        ((2 * x + 1) * from.0 / (2 * width), (2 * y + 1) * from.1 / (2 * height))
    }
}
