//! What densification asks others.

use super::flow::FlowSource;
use super::segment::Segmenter;

/// Who measures flow, and who knows outlines.
#[derive(Clone, Copy)]
pub struct Sources<'a> {
    /// Measures flow between neighbouring frames.
    pub flow: &'a dyn FlowSource,
    /// Outlines what moves, if there is one; masks that are given stay as they are.
    pub segmenter: Option<&'a dyn Segmenter>,
}

impl<'a> Sources<'a> {
    /// Flow alone.
    #[must_use]
    pub fn flow(flow: &'a dyn FlowSource) -> Self {
        Self { flow, segmenter: None }
    }
}
