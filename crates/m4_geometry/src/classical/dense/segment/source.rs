//! The seam between dense geometry and whatever knows the outline of things.

use m4_core::RgbImage;

/// What is known of one thing. Places are in pixels of the size that was asked for; the centre of the first pixel is (0.5, 0.5).
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentPrompt {
    /// Columns and rows of places on the thing, the surest first.
    pub points_px: Vec<[f32; 2]>,
    /// Columns and rows of places that are not on the thing.
    pub off_points_px: Vec<[f32; 2]>,
    /// Column and row of the centre of the first pixel of the thing's box, then of the last.
    pub box_px: [f32; 4],
    /// `[height][width]`, logits: above 0 where the thing is believed to be.
    pub belief: Vec<f32>,
}

/// What a segmenter makes of a prompt.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentMask {
    /// `[height][width]`: above 0 where the thing is.
    pub logits: Vec<f32>,
    /// How far the segmenter trusts the mask: its intersection with the true one over their union, as expected.
    pub quality: f32,
}

/// Why there are no masks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SegmentError {
    /// The segmenter failed.
    #[error("{segmenter} found no masks: {reason}")]
    Source {
        /// Its name.
        segmenter: String,
        /// What went wrong.
        reason: Box<dyn std::error::Error + Send + Sync>,
    },
    /// Another number of masks than of prompts.
    #[error("{found} masks for {expected} prompts")]
    Count {
        /// Masks.
        found: usize,
        /// Prompts.
        expected: usize,
    },
    /// A mask of another size than that asked for.
    #[error("a mask has {found} values where {} x {} were asked for", expected.0, expected.1)]
    Size {
        /// Values of the mask.
        found: usize,
        /// Width and height that were asked for.
        expected: (usize, usize),
    },
}

/// Finds the outline of what a prompt means in an image.
///
/// Called from several threads at once; the same image and prompts must give the same bits.
pub trait Segmenter: Sync {
    /// For records and messages, as `--segmenter` names it.
    fn name(&self) -> &str;

    /// A mask for every prompt, in their order. Prompts and masks are of `size` (width, height), which may be less than that of `image` but
    /// has its shape.
    ///
    /// # Errors
    ///
    /// [`SegmentError`] where the segmenter fails.
    fn masks(
        &self,
        image: &RgbImage,
        size: (usize, usize),
        prompts: &[SegmentPrompt],
    ) -> Result<Vec<SegmentMask>, SegmentError>;
}
