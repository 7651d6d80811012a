//! What refinement asks of a method that follows outlined objects through a clip.

use super::InstanceError;
use m4_core::{CompactMask, Progress};

/// Which thing, as the caller of a [`VideoSession`] numbers it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
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

/// Mask of an object in a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectMask {
    /// The thing.
    pub object: ObjectId,
    /// Its pixels, at the size of the session; none while it is occluded or out of view.
    pub mask: CompactMask,
    /// It will not be found again by going on: the mask is empty, and it need not be asked for
    /// further on.
    pub lost: bool,
}

impl ObjectMask {
    /// A thing that is not to be seen, of a session of `size`.
    #[must_use]
    pub fn unseen(object: ObjectId, size: (usize, usize), lost: bool) -> Self {
        Self {
            object,
            mask: CompactMask::from_fn(size.0, size.1, |_, _| false),
            lost,
        }
    }
}

/// A clip in which things are followed once they were pointed at; prompts and masks are of one size
/// for the session, which may be less than that of the frames but has their shape. The same calls
/// in the same order give the same bits, for any number of threads.
///
/// What a session keeps between calls is its own business (memories, features, the last masks); it
/// must not grow with the frames that were passed.
pub trait VideoSession {
    /// For records and messages.
    fn name(&self) -> &str;

    /// Whether it knows what a thing looks like. One that does not carries masks from frame to
    /// frame, and what it gives is held near the coarse masks.
    fn remembers(&self) -> bool {
        true
    }

    /// The masks of things in `frame` as the prompts mean them, one a prompt, in their order. A
    /// thing that was prompted before in this frame is prompted anew; prompts in several frames add
    /// up.
    ///
    /// # Errors
    ///
    /// [`InstanceError::Source`] where the segmenter fails.
    fn prompt(
        &mut self,
        frame: usize,
        prompts: &[ObjectPrompt],
    ) -> Result<Vec<ObjectMask>, InstanceError>;

    /// Says what the mask of a thing in `frame` is, in place of what a prompt there gave.
    ///
    /// # Errors
    ///
    /// [`InstanceError::Source`] where the segmenter fails.
    fn set_mask(
        &mut self,
        frame: usize,
        object: ObjectId,
        mask: &CompactMask,
    ) -> Result<(), InstanceError>;

    /// Drops a thing and all that is known of it; one that is not known is no error.
    fn forget(&mut self, object: ObjectId);

    /// Follows things, all in one pass, from frame `from`, in which each must be prompted or
    /// reached earlier in the same direction, to frame `to`: forwards if `to` is after `from`,
    /// backwards if before, not at all if the same. `sink` gets each frame after `from` up to `to`
    /// with a mask for every thing in the order of `objects`.
    ///
    /// An object may be followed backwards long after it was followed forwards.
    ///
    /// # Errors
    ///
    /// [`InstanceError`] where the segmenter fails or `progress` says to stop.
    fn follow(
        &mut self,
        objects: &[ObjectId],
        from: usize,
        to: usize,
        progress: &dyn Progress,
        sink: &mut dyn FnMut(usize, Vec<ObjectMask>),
    ) -> Result<(), InstanceError>;
}
