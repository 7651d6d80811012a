//! The seam between refinement and whatever tracks outlined objects through a clip, whose images come one by one.

use crate::classical::dense::{FlowError, ScaledFrame, SegmentError};
use m4_core::{CompactMask, Progress, RgbImage};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::ops::ControlFlow;

/// Which thing, as the caller of a [`VideoSession`] numbers it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ObjectId(pub u32);

/// What is known of a thing in one frame. A segmenter takes of it what it can use.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectPrompt {
    /// The thing.
    pub object: ObjectId,
    /// Columns and rows of places on the thing, the surest first.
    pub on_px: Vec<[f32; 2]>,
    /// Columns and rows of places that are not on the thing.
    pub off_px: Vec<[f32; 2]>,
    /// Column and row of the centre of the first pixel of the thing's box, then of the last.
    pub box_px: [f32; 4],
    /// `[height][width]`, logits of a coarse mask: above 0 where the thing is believed to be.
    pub belief: Vec<f32>,
}

/// Visibility of an object in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Visibility {
    /// The mask shows it.
    Visible,
    /// Occluded or out of view, but may come back: the mask is empty.
    Occluded,
    /// It will not be found again by going on: the mask is empty, and it need not be asked for further on.
    Lost,
}

/// Mask of an object in a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectMask {
    /// The thing.
    pub object: ObjectId,
    /// Its pixels, at the size of the session.
    pub mask: CompactMask,
    /// How far the mask is trusted: its expected intersection over union with the true one; `None` where unknown.
    pub quality: Option<f32>,
    /// How it is seen.
    pub visibility: Visibility,
}

impl ObjectMask {
    /// A thing that is not to be seen, of a session of `size`.
    #[must_use]
    pub fn unseen(object: ObjectId, size: (usize, usize), visibility: Visibility) -> Self {
        Self { object, mask: CompactMask::from_fn(size.0, size.1, |_, _| false), quality: None, visibility }
    }
}

/// Why nothing could be followed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VideoError {
    /// The segmenter failed.
    #[error("{segmenter} cannot track objects in frame {frame}: {reason}")]
    Source {
        /// Its name.
        segmenter: String,
        /// The frame at which it was.
        frame: usize,
        /// What went wrong.
        reason: Box<dyn std::error::Error + Send + Sync>,
    },
    /// An image cannot be read.
    #[error("frame {frame} of the clip cannot be read: {reason}")]
    Image {
        /// The frame.
        frame: usize,
        /// What went wrong.
        reason: ImageError,
    },
    /// The source of flow failed.
    #[error("no flow between frames {} and {}", between.0, between.1)]
    Flow {
        /// The two frames.
        between: (usize, usize),
        /// What went wrong.
        source: FlowError,
    },
    /// The segmenter of single images failed.
    #[error("no object masks in frame {frame}")]
    Segment {
        /// The frame.
        frame: usize,
        /// What went wrong.
        source: SegmentError,
    },
    /// Frames, things or masks that do not belong to the clip; the text says which.
    #[error("{0}")]
    Input(String),
    /// The caller asked to stop.
    #[error("stopped on request while tracking objects, at frame {frame}")]
    Cancelled {
        /// The frame that was next.
        frame: usize,
    },
}

impl VideoError {
    /// A thing is to be followed from a frame at which it is not known.
    #[must_use]
    pub fn unknown(object: ObjectId, frame: usize) -> Self {
        let object = object.0;
        Self::Input(format!(
            "object {object} is not known in frame {frame}; prompt it there, or track it to that frame first"
        ))
    }

    /// Refuses a frame that a clip of `frames` frames does not have.
    ///
    /// # Errors
    ///
    /// [`VideoError::Input`].
    pub fn check_frame(frame: usize, frames: usize) -> Result<(), Self> {
        if frame < frames {
            return Ok(());
        }
        Err(Self::Input(format!("frame {frame} was asked for in a clip of {frames} frames")))
    }

    /// Refuses a prompt whose belief has another size than the session.
    ///
    /// # Errors
    ///
    /// [`VideoError::Input`].
    pub fn check_prompt(prompt: &ObjectPrompt, (width, height): (usize, usize)) -> Result<(), Self> {
        let (object, found) = (prompt.object.0, prompt.belief.len());
        if found == width * height {
            return Ok(());
        }
        Err(Self::Input(format!(
            "the logits of object {object} have {found} values where {width} x {height} were expected"
        )))
    }

    /// Refuses a mask of another size than the session.
    ///
    /// # Errors
    ///
    /// [`VideoError::Input`].
    pub fn check_mask(object: ObjectId, mask: &CompactMask, size: (usize, usize)) -> Result<(), Self> {
        let (object, found) = (object.0, mask.size());
        if found == size {
            return Ok(());
        }
        Err(Self::Input(format!(
            "the mask of object {object} is {}x{} where {}x{} was expected",
            found.0, found.1, size.0, size.1
        )))
    }
}

/// Finds things in a clip once they were pointed at.
pub trait VideoSegmenter: Sync {
    /// For records and messages.
    fn name(&self) -> &str;

    /// Whether it knows what a thing looks like. One that does not carries masks from frame to frame, and what it gives is held near the
    /// coarse masks.
    fn remembers(&self) -> bool {
        true
    }

    /// Starts on a clip; prompts and masks are of `size` (width, height), which may be less than that of the frames but has
    /// their shape. No frame need be read yet.
    ///
    /// # Errors
    ///
    /// [`VideoError`] where the segmenter cannot work on such a clip.
    fn open<'a>(
        &'a self,
        clip: &'a dyn FrameSource,
        size: (usize, usize),
    ) -> Result<Box<dyn VideoSession + 'a>, VideoError>;
}

/// A clip in which things are followed. The same calls in the same order give the same bits, for any number of threads.
///
/// What a session keeps between calls is its own business (memories, features, the last masks); it must not grow with the frames that
/// were passed.
pub trait VideoSession {
    /// The masks of things in `frame` as the prompts mean them, one a prompt, in their order. A thing that was prompted before in this
    /// frame is prompted anew; prompts in several frames add up.
    ///
    /// # Errors
    ///
    /// [`VideoError`] where the segmenter fails.
    fn prompt(&mut self, frame: usize, prompts: &[ObjectPrompt]) -> Result<Vec<ObjectMask>, VideoError>;

    /// Says what the mask of a thing in `frame` is, in place of what a prompt there gave.
    ///
    /// # Errors
    ///
    /// [`VideoError`] where the mask does not fit.
    fn set_mask(&mut self, frame: usize, object: ObjectId, mask: &CompactMask) -> Result<(), VideoError>;

    /// Drops a thing and all that is known of it; one that is not known is no error.
    fn forget(&mut self, object: ObjectId);

    /// Follows things, all in one pass, from frame `from`, in which each must be prompted or reached earlier in the same direction, to frame `to`:
    /// forwards if `to` is after `from`, backwards if before, not at all if the same. `sink` gets each frame after `from` up to `to`
    /// with a mask for every thing in the order of `objects`, and may end the pass.
    ///
    /// An object may be followed backwards long after it was followed forwards.
    ///
    /// # Errors
    ///
    /// [`VideoError`] where the segmenter fails or `progress` says to stop.
    fn follow(
        &mut self,
        objects: &[ObjectId],
        from: usize,
        to: usize,
        progress: &dyn Progress,
        sink: &mut dyn FnMut(usize, Vec<ObjectMask>) -> ControlFlow<()>,
    ) -> Result<(), VideoError>;
}

/// The error of an image that cannot be read.
pub type ImageError = Box<dyn std::error::Error + Send + Sync>;

/// Frames by index. They are requested when needed and not cached, so a clip may read them from disk.
///
/// Called from several threads at once; the same frame must be the same image every time.
pub trait FrameSource: Sync {
    /// How many frames there are.
    fn frames(&self) -> usize;

    /// Width and height of every frame, pixels.
    fn size(&self) -> (usize, usize);

    /// Frame `frame`, below [`Self::frames`].
    ///
    /// # Errors
    ///
    /// An image that cannot be read.
    fn image(&self, frame: usize) -> Result<Cow<'_, RgbImage>, ImageError>;
}

/// Images in memory, all of the size of the first.
#[derive(Debug, Clone, Copy)]
pub struct ImageList<'a>(pub &'a [&'a RgbImage]);

impl FrameSource for ImageList<'_> {
    fn frames(&self) -> usize {
        self.0.len()
    }

    fn size(&self) -> (usize, usize) {
        self.0.first().map_or((0, 0), |image| image.size())
    }

    fn image(&self, frame: usize) -> Result<Cow<'_, RgbImage>, ImageError> {
        match self.0.get(frame) {
            Some(image) => Ok(Cow::Borrowed(image)),
            None => Err(format!("there are {} frames", self.0.len()).into()),
        }
    }
}

/// Reads a frame and checks its size.
pub(super) fn read(clip: &dyn FrameSource, frame: usize) -> Result<Cow<'_, RgbImage>, VideoError> {
    VideoError::check_frame(frame, clip.frames())?;
    let image = clip.image(frame).map_err(|reason| VideoError::Image { frame, reason })?;
    let (found, expected) = (image.size(), clip.size());
    if found != expected {
        return Err(VideoError::Input(format!(
            "frame {frame} is {}x{} where {}x{} was expected; all frames must have one size",
            found.0, found.1, expected.0, expected.1
        )));
    }
    Ok(image)
}

/// A frame of a clip at a size that is not larger than its own.
pub(super) fn scaled(clip: &dyn FrameSource, frame: usize, size: (usize, usize)) -> Result<ScaledFrame, VideoError> {
    Ok(ScaledFrame::new(read(clip, frame)?.as_ref(), size))
}
