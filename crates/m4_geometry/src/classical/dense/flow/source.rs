//! The seam between dense geometry and whatever measures optical flow.

use super::flow;
use super::pyramid::Pyramid;
use m4_core::Flow;

/// One image, as a source of flow sees it.
#[derive(Debug, Clone, Copy)]
pub struct FlowImage<'a> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height][width][3]`, sRGB 0..255.
    pub rgb: &'a [[u8; 3]],
    /// `[height][width]`: luma 0..255, not rounded.
    pub grey: &'a [f32],
}

/// Why there is no flow.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FlowError {
    /// The source failed.
    #[error("{source_name} found no flow: {reason}")]
    Source {
        /// Its name.
        source_name: String,
        /// What went wrong.
        reason: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The source gave flow of another size than that of its images.
    #[error("the flow has {}x{} values where the images have {}x{}", found.0, found.1, expected.0, expected.1)]
    Size {
        /// Width and height of the flow.
        found: (usize, usize),
        /// Width and height of the images.
        expected: (usize, usize),
    },
}

/// Measures where the pixels of one image are seen in another: classical search, a network, another program's result.
///
/// Called from several threads at once; the same images must give the same bits.
pub trait FlowSource: Sync {
    /// For records and messages, as `--frontend` names it.
    fn name(&self) -> &str;

    /// The flow from `a` to `b` and that from `b` to `a`, of the size of the images, which is the same for both.
    ///
    /// # Errors
    ///
    /// [`FlowError`] where the source fails.
    fn both(&self, a: &FlowImage<'_>, b: &FlowImage<'_>) -> Result<(Flow, Flow), FlowError>;
}

/// Inverse search with variational refinement (Kroeger et al. 2016): no weights, and the default.
#[derive(Debug, Clone, Copy)]
pub struct InverseSearch;

impl FlowSource for InverseSearch {
    fn name(&self) -> &'static str {
        "classical"
    }

    fn both(&self, a: &FlowImage<'_>, b: &FlowImage<'_>) -> Result<(Flow, Flow), FlowError> {
        let pyramid = |p: &FlowImage<'_>| Pyramid::new(p.width, p.height, p.grey);
        let (a, b) = (pyramid(a), pyramid(b));
        Ok((flow(&a, &b), flow(&b, &a)))
    }
}
