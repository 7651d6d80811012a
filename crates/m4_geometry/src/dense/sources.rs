//! What densification asks others, and where it puts what it finished.

use super::flow::FlowSource;
use super::mono::{MonoDepth, NoDepth};
use super::segment::Segmenter;
use m4_core::{Cache, NoCache};

/// Sources of flow, masks and depth.
#[derive(Clone, Copy)]
pub struct Sources<'a> {
    /// Measures flow between neighbouring frames.
    pub flow: &'a dyn FlowSource,
    /// Segments dynamic regions, if present; masks of the user stay as they are.
    pub segmenter: Option<&'a dyn Segmenter>,
    /// Depth from one image: [`NoDepth`] if there is none.
    pub mono: &'a dyn MonoDepth,
    /// Keeps what is finished of each frame, and has what an earlier attempt finished: [`NoCache`] if there is none.
    pub cache: &'a dyn Cache,
}

impl<'a> Sources<'a> {
    /// Flow alone.
    #[must_use]
    pub fn flow(flow: &'a dyn FlowSource) -> Self {
        Self {
            flow,
            segmenter: None,
            mono: &NoDepth,
            cache: &NoCache,
        }
    }
}
