//! Following by optical flow, with a segmenter of single images or without.
//!
//! ```text
//! mask of frame t --flow, there and back--> carried to t + 1 --edges of t + 1--> carried mask
//!   carried mask --box, points, belief--> Segmenter --plausible?--> its mask, else the carried one
//! ```
//!
//! Without a segmenter nothing holds a mask to its thing but the edges of the frames: masks drift, and grow over what looks alike, within tens of
//! frames. A thing of which too little arrives is lost for good: nothing here remembers what it looks like. Source: mask propagation by
//! flow is old; the rule when to believe a segmenter is that of `dense::segment`.

mod ask;
mod scaled_frame;
mod session;
mod warp;

pub(super) use scaled_frame::ScaledFrame;

use super::frame_source::FrameSource;
use super::source::{VideoError, VideoSegmenter, VideoSession};
use crate::classical::dense::{FlowSource, Segmenter};

/// Carries masks along optical flow. Where there is a segmenter of single images, it says what they mean in each frame.
pub struct FlowFollower<'a> {
    flow: &'a dyn FlowSource,
    segmenter: Option<&'a dyn Segmenter>,
    name: String,
}

impl<'a> FlowFollower<'a> {
    /// Follows by flow of `flow`; `segmenter` may outline things in each frame.
    #[must_use]
    pub fn new(flow: &'a dyn FlowSource, segmenter: Option<&'a dyn Segmenter>) -> Self {
        let name = match segmenter {
            Some(segmenter) => format!("{}+{}", segmenter.name(), flow.name()),
            None => flow.name().to_owned(),
        };
        Self { flow, segmenter, name }
    }
}

impl VideoSegmenter for FlowFollower<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn remembers(&self) -> bool {
        false
    }

    fn open<'b>(
        &'b self,
        clip: &'b dyn FrameSource,
        size: (usize, usize),
    ) -> Result<Box<dyn VideoSession + 'b>, VideoError> {
        Ok(Box::new(session::Session::new(self, clip, size)))
    }
}
