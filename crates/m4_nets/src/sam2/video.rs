//! Objects followed through a clip.
//!
//! ```text
//! show an object in a frame --> its mask there (pending)
//! follow: pending masks become memories; then frame by frame, each object that was not shown there:
//!     memories and pointers of frames before and of those that were shown --> mask --> memory, pointer
//! ```
//!
//! Objects do not know of each other; those that have equally many memories are computed together.
//! A frame's features are computed once for all of them.

use super::bank::{Entry, Object, ObjectMask, Recall};
use super::prompts::{squared_mask, with_pixels};
use super::recall::Answer;
use super::{Features, Sam2, prompts};
use crate::error::refuse;
use crate::ops::tensor;
use crate::sam::Prompt;
use crate::{ImageReader, NetError};
use burn_core::tensor::Tensor;
use m4_core::{Plane, Progress};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::ops::{ControlFlow, RangeInclusive};
use std::sync::Arc;

/// Which way objects are followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// Later frames after earlier ones.
    Forward,
    /// Earlier frames after later ones.
    Backward,
}

impl Direction {
    /// The frame that came `steps` before `frame`; it may lie beyond the clip's end.
    pub(super) fn before(self, frame: usize, steps: usize) -> Option<usize> {
        match self {
            Self::Forward => frame.checked_sub(steps),
            Self::Backward => frame.checked_add(steps),
        }
    }
}

/// A clip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VideoSize {
    /// Frames.
    pub frames: usize,
    /// Columns that places of prompts are counted in, whatever the size of the images.
    pub width: usize,
    /// Rows, likewise.
    pub height: usize,
}

/// Objects that are computed together, at most.
const TOGETHER: usize = 4;
/// Frames whose features are kept.
const FEATURES: usize = 3;
/// The largest logit of an earlier mask that a prompt takes up, up or down.
const EARLIER_LOGIT: f32 = 32.0;

/// Follows objects through a clip.
///
/// What is kept does not grow with the clip but for two numbers an object and frame: a megabyte for
/// each of six frames before the last, a quarter of one for each of 15, and the same on both sides
/// of each frame that an object was shown in.
pub struct VideoPredictor<'a> {
    pub(super) net: Arc<Sam2>,
    clip: VideoSize,
    images: ImageReader<'a>,
    fill_holes_px: usize,
    pub(super) objects: BTreeMap<u32, Object>,
    /// The last ones last.
    features: Vec<(usize, Arc<Features>)>,
}

impl fmt::Debug for VideoPredictor<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("VideoPredictor")
            .field("clip", &self.clip)
            .field("objects", &self.objects.keys())
            .finish_non_exhaustive()
    }
}

impl<'a> VideoPredictor<'a> {
    /// For `clip`, whose images, of any size, are asked for where they are needed. Holes of masks
    /// of at most `fill_holes_px` pixels of the logits are filled; 0 fills none. Upstream fills 8
    /// where it runs on CUDA, and none elsewhere.
    ///
    /// # Errors
    ///
    /// [`NetError`] if the clip has no frames or no pixels.
    pub fn new(
        net: Arc<Sam2>,
        clip: VideoSize,
        images: ImageReader<'a>,
        fill_holes_px: usize,
    ) -> Result<Self, NetError> {
        if clip.frames == 0 {
            return refuse("a clip without frames has no masks");
        }
        with_pixels("a clip", (clip.width, clip.height))?;
        Ok(Self {
            net,
            clip,
            images,
            fill_holes_px,
            objects: BTreeMap::new(),
            features: Vec::new(),
        })
    }

    /// Objects that were shown.
    pub fn objects(&self) -> impl Iterator<Item = u32> {
        self.objects.keys().copied()
    }

    /// Forgets an object.
    ///
    /// # Errors
    ///
    /// [`NetError::UnknownObject`] if it was never shown.
    pub fn remove(&mut self, object: u32) -> Result<(), NetError> {
        let state = self.objects.remove(&object);
        state.map(drop).ok_or(NetError::UnknownObject(object))
    }

    fn check(&self, frame: usize) -> Result<(), NetError> {
        let frames = self.clip.frames;
        if frame < frames {
            Ok(())
        } else {
            Err(NetError::NoSuchFrame { frame, frames })
        }
    }

    /// Shows an object in a frame by places, with a name of the caller's choice, or corrects it
    /// there; its mask in that frame. All places of the frame are given each time: they replace
    /// earlier ones. `mask_logits` of the prompt take the place of what was found in that frame
    /// before, which else counts. Other frames learn of it when they are [followed
    /// to](Self::follow).
    ///
    /// # Errors
    ///
    /// [`NetError`] if the clip has no such frame, the prompt is empty or wrong, or the image or
    /// the device fails.
    pub fn show(
        &mut self,
        frame: usize,
        object: u32,
        prompt: &Prompt,
    ) -> Result<ObjectMask, NetError> {
        self.check(frame)?;
        let size = (self.clip.width, self.clip.height);
        let net = Arc::clone(&self.net);
        prompt.check(size, net.mask_side())?;
        let tokens = prompts::tokens(&net.net.prompt_encoder, prompt, size, net.side);
        let prompt_logits = prompt.mask_logits.as_ref();
        let state = self.objects.get(&object);
        let mask = prompt_logits.or_else(|| state?.at(frame).map(|entry| &entry.mask.logits));
        let mask =
            mask.map(|mask| prompts::mask(mask, &net.device).clamp(-EARLIER_LOGIT, EARLIER_LOGIT));
        let recall = state.and_then(|state| {
            let direction = *state.followed.get(&frame)?;
            let recall = state.recall(frame, direction, self.clip.frames);
            (!recall.memories.is_empty()).then_some(recall)
        });
        let first = state.is_none_or(|state| !state.followed.contains_key(&frame));
        let features = self.features(frame)?;
        let map = match recall {
            Some(recall) => net.recalled(net.begun(&features), &[recall], self.clip.frames),
            None => net.unremembered(&features),
        };
        let decoded = net.decoded(map, &features, tokens.unsqueeze_dim(0), mask);
        let answers = net.answers(decoded, prompt.is_ambiguous())?;
        self.pend(frame, object, answers, first)
    }

    /// Shows an object in a frame by its mask, of any size with pixels over the whole image.
    ///
    /// # Errors
    ///
    /// As [`Self::show`].
    pub fn show_mask(
        &mut self,
        frame: usize,
        object: u32,
        mask: &Plane<bool>,
    ) -> Result<ObjectMask, NetError> {
        self.check(frame)?;
        with_pixels("a mask", mask.size())?;
        let net = Arc::clone(&self.net);
        let features = self.features(frame)?;
        let state = self.objects.get(&object);
        let first = state.is_none_or(|state| !state.followed.contains_key(&frame));
        let answer = net.answer_of_mask(&features, squared_mask(mask, net.side))?;
        self.pend(frame, object, vec![answer], first)
    }

    /// Keeps what was shown, the first of `answers`, until objects are followed.
    fn pend(
        &mut self,
        frame: usize,
        object: u32,
        answers: Vec<Answer>,
        first: bool,
    ) -> Result<ObjectMask, NetError> {
        let nothing = || NetError::Device("no answer".to_owned());
        let answer = answers.into_iter().next().ok_or_else(nothing)?;
        let entry = Entry::of(answer, self.fill_holes_px, true)?;
        let mask = entry.mask.clone();
        let state = self.objects.entry(object).or_default();
        // what was shown first is corrected where it is
        let conditions = first || state.conditioning.contains_key(&frame);
        state.pending.insert(frame, (entry, conditions));
        Ok(mask)
    }

    /// Follows all objects through `frames`, from the first to the last or from the last to the
    /// first; `each` gets the frame and the masks of all objects in it. What was shown in a frame
    /// is given as it was found there.
    ///
    /// # Errors
    ///
    /// [`NetError`] if there is no object, the clip has no such frames, `progress` says to stop, or
    /// an image or the device fails. Frames that `each` got stay followed.
    pub fn follow(
        &mut self,
        frames: RangeInclusive<usize>,
        direction: Direction,
        progress: &dyn Progress,
        mut each: impl FnMut(usize, &BTreeMap<u32, ObjectMask>),
    ) -> Result<(), NetError> {
        let all: Vec<u32> = self.objects().collect();
        self.follow_some(&all, frames, direction, progress, |frame, masks| {
            each(frame, masks);
            ControlFlow::Continue(())
        })
    }

    /// The same for some objects alone; others stay as they are. `each` may end it.
    ///
    /// # Errors
    ///
    /// As [`Self::follow`]; [`NetError::UnknownObject`] if one was never shown.
    pub fn follow_some(
        &mut self,
        objects: &[u32],
        frames: RangeInclusive<usize>,
        direction: Direction,
        progress: &dyn Progress,
        mut each: impl FnMut(usize, &BTreeMap<u32, ObjectMask>) -> ControlFlow<()>,
    ) -> Result<(), NetError> {
        if objects.is_empty() {
            return refuse("there is no object to track; prompt one in a frame first");
        }
        if let Some(&unknown) = objects.iter().find(|id| !self.objects.contains_key(id)) {
            return Err(NetError::UnknownObject(unknown));
        }
        self.check(*frames.start())?;
        self.check(*frames.end())?;
        let some: BTreeSet<u32> = objects.iter().copied().collect();
        let total = frames.clone().count();
        self.settle(progress)?;
        for done in 0..total {
            if progress.cancelled() {
                return Err(NetError::Cancelled);
            }
            let frame = match direction {
                Direction::Forward => frames.start() + done,
                Direction::Backward => frames.end() - done,
            };
            let masks = self.step(frame, direction, &some)?;
            progress.update("masks", done + 1, total, "");
            if each(frame, &masks).is_break() {
                break;
            }
        }
        Ok(())
    }

    /// Encodes memories of what was shown.
    fn settle(&mut self, progress: &dyn Progress) -> Result<(), NetError> {
        let net = Arc::clone(&self.net);
        let pending: Vec<(u32, usize)> = self
            .objects
            .iter()
            .flat_map(|(&id, object)| object.pending.keys().map(move |&frame| (id, frame)))
            .collect();
        for (id, frame) in pending {
            if progress.cancelled() {
                return Err(NetError::Cancelled);
            }
            let features = self.features(frame)?;
            let Some(object) = self.objects.get_mut(&id) else {
                continue;
            };
            let Some((mut entry, conditions)) = object.pending.remove(&frame) else {
                continue;
            };
            let side = net.mask_side();
            let logits = tensor(
                entry.mask.logits.data().to_vec(),
                [1, side, side],
                &net.device,
            );
            let enlarged = net.enlarged(logits);
            let mask = enlarged
                .clone()
                .greater_elem(0.0)
                .float()
                .cast(enlarged.dtype());
            entry.memory = Some(net.remembered(&features, mask, &[entry.mask.is_there()]));
            object.settle(frame, entry, conditions);
        }
        Ok(())
    }

    /// The masks of `some` objects in a frame.
    fn step(
        &mut self,
        frame: usize,
        direction: Direction,
        some: &BTreeSet<u32>,
    ) -> Result<BTreeMap<u32, ObjectMask>, NetError> {
        let mut groups: BTreeMap<(usize, usize), Vec<(u32, Recall)>> = BTreeMap::new();
        for (&id, object) in &self.objects {
            if some.contains(&id) && object.shown(frame).is_none() {
                let recall = object.recall(frame, direction, self.clip.frames);
                let size = (recall.memories.len(), recall.pointers.len());
                groups.entry(size).or_default().push((id, recall));
            }
        }
        if !groups.is_empty() {
            let net = Arc::clone(&self.net);
            let features = self.features(frame)?;
            let begun = net.begun(&features);
            for (_, group) in groups {
                for part in group.chunks(TOGETHER) {
                    let entries = self.entries(&net, &features, &begun, part)?;
                    for (id, entry) in entries {
                        if let Some(object) = self.objects.get_mut(&id) {
                            object.others.insert(frame, entry);
                        }
                    }
                }
            }
        }
        let mut masks = BTreeMap::new();
        for (&id, object) in self.objects.iter_mut().filter(|(id, _)| some.contains(id)) {
            object.followed.insert(frame, direction);
            object.forget(frame);
            masks.extend(object.at(frame).map(|entry| (id, entry.mask.clone())));
        }
        Ok(masks)
    }

    /// Some objects, which have equally many memories, in a frame.
    fn entries(
        &self,
        net: &Sam2,
        features: &Features,
        begun: &Tensor<3>,
        some: &[(u32, Recall)],
    ) -> Result<Vec<(u32, Entry)>, NetError> {
        let recalls: Vec<Recall> = some.iter().map(|(_, recall)| recall.clone()).collect();
        let map = net.recalled(begun.clone(), &recalls, self.clip.frames);
        let answers = net.followed(map, features)?;
        let logits = answers.iter().map(|answer| answer.logits.clone()).collect();
        let presence: Vec<bool> = answers.iter().map(|answer| answer.score > 0.0).collect();
        let masks = crate::ops::sigmoid(net.enlarged(Tensor::cat(logits, 0)));
        let memories = net.remembered(features, masks, &presence);
        let mut entries = Vec::new();
        for (i, (answer, (id, _))) in answers.into_iter().zip(some).enumerate() {
            let mut entry = Entry::of(answer, self.fill_holes_px, false)?;
            entry.memory = Some(memories.clone().narrow(0, i, 1));
            entries.push((*id, entry));
        }
        Ok(entries)
    }

    /// A frame's features.
    pub(super) fn features(&mut self, frame: usize) -> Result<Arc<Features>, NetError> {
        if let Some(i) = self.features.iter().position(|(at, _)| *at == frame) {
            let entry = self.features.remove(i);
            let features = Arc::clone(&entry.1);
            self.features.push(entry);
            return Ok(features);
        }
        let image = (self.images)(frame).map_err(|reason| NetError::Frame { frame, reason })?;
        let features = Arc::new(self.net.encode(&image)?);
        if self.features.len() >= FEATURES {
            self.features.remove(0);
        }
        self.features.push((frame, Arc::clone(&features)));
        Ok(features)
    }
}
