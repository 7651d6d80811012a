//! The methods that the dense stage uses.

use super::flow::FlowSource;
use super::mono::{MonoDepth, NoDepth};
use super::segment::Segmenter;

/// The methods for flow, segmentation and monocular depth.
#[derive(Clone, Copy)]
pub struct Sources<'a> {
    /// Measures flow between neighbouring frames.
    pub flow: &'a dyn FlowSource,
    /// Segments dynamic regions, if present; masks of the user stay as they are.
    pub segmenter: Option<&'a dyn Segmenter>,
    /// Depth from one image: [`NoDepth`] if there is none.
    pub mono: &'a dyn MonoDepth,
}

impl<'a> Sources<'a> {
    /// Flow alone.
    #[must_use]
    pub fn flow(flow: &'a dyn FlowSource) -> Self {
        Self {
            flow,
            segmenter: None,
            mono: &NoDepth,
        }
    }
}
