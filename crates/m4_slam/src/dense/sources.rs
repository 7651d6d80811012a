//! What densification asks others.

use super::flow::FlowSource;
use super::mono::{MonoDepth, NoDepth};
use super::segment::Segmenter;

/// Who measures flow, who knows outlines, and who knows depth.
#[derive(Clone, Copy)]
pub struct Sources<'a> {
    /// Measures flow between neighbouring frames.
    pub flow: &'a dyn FlowSource,
    /// Outlines what moves, if there is one; masks that are given stay as they are.
    pub segmenter: Option<&'a dyn Segmenter>,
    /// Depth from one picture: [`NoDepth`] if there is none.
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
