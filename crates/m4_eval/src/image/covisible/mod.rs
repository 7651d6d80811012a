//! Co-visibility: the pixels of a test image that the training frames saw. Scores elsewhere would measure invention, not reconstruction.
//!
//! ```text
//! test image, each training frame --flow, or depth and poses--> which pixels it saw --CovisibleCounts--> mask
//! ```
//!
//! DyCheck (Gao et al., NeurIPS 2022, section 3.2) counts, for each pixel of the test image, the training frames in which it is
//! not occluded by the forward-backward check of optical flow ([`seen_by_flow`]), and keeps those that more than
//! max(5, a tenth of the frames) saw. The masks that its authors publish (`covisible/2x/val`) were made so with RAFT; where they are
//! at hand they should be used, for figures to be comparable. [`seen_by_depth`] serves captures that have depth and poses instead: it
//! cannot follow the dynamic part, so that a moving thing counts as seen only by the frames in which it stands where it stood.

mod depth;
mod flow;

pub use depth::{DEPTH_TOLERANCE, DepthView, seen_by_depth};
pub use flow::seen_by_flow;

use super::{ImageError, same_size};
use m4_core::{Mask, Plane};

/// How many training frames are not enough: a covisible pixel was seen by more. As `process_covisible.py` of DyCheck has it, though
/// its paper and others write "at least".
#[must_use]
pub fn too_few_frames(training_frames: usize) -> usize {
    (training_frames / 10).max(5)
}

/// Number of training frames that saw each pixel of a test image.
#[derive(Debug, Clone, PartialEq)]
pub struct CovisibleCounts {
    counts: Plane<u32>,
    frames: usize,
}

impl CovisibleCounts {
    /// None yet, for an image of `width` by `height`.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            counts: Plane::filled(width, height, 0),
            frames: 0,
        }
    }

    /// Adds a training frame, which saw the pixels of the test image that are not 0 in `seen`.
    ///
    /// # Errors
    ///
    /// [`ImageError::Size`] if `seen` has another size.
    pub fn add(&mut self, seen: &Mask) -> Result<(), ImageError> {
        same_size("the mask of what a training frame saw", self.counts.size(), seen.size())?;
        for (count, &seen) in self.counts.data_mut().iter_mut().zip(seen.data()) {
            *count += u32::from(seen != 0);
        }
        self.frames += 1;
        Ok(())
    }

    /// Training frames so far.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Number of frames that saw each pixel, `[height][width]`.
    #[must_use]
    pub fn counts(&self) -> &Plane<u32> {
        &self.counts
    }

    /// 255 where more than [`too_few_frames`] saw the pixel, else 0.
    #[must_use]
    pub fn mask(&self) -> Mask {
        let few = too_few_frames(self.frames);
        self.counts.map(|&n| if n as usize > few { 255 } else { 0 })
    }
}

#[cfg(test)]
mod tests {
    use super::{CovisibleCounts, too_few_frames};
    use m4_core::Plane;

    #[test]
    fn a_tenth_of_the_frames_but_five_are_too_few() {
        assert_eq!([0, 59, 60, 435].map(too_few_frames), [5, 5, 6, 43]);
        let mut counts = CovisibleCounts::new(4, 1);
        for i in 0..7 {
            let seen = Plane::from_fn(4, 1, |x, _| if i < [0, 5, 6, 7][x] { 1 } else { 0 });
            counts.add(&seen).unwrap();
        }
        assert_eq!(counts.frames(), 7);
        assert_eq!(counts.counts().data(), [0, 5, 6, 7]);
        assert_eq!(counts.mask().data(), [0, 0, 255, 255]);
        assert!(counts.add(&Plane::filled(1, 4, 1)).is_err());
    }
}
