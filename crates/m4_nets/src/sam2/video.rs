//! Objects followed through a clip.
//!
//! ```text
//! show an object in a frame --> its mask there (pending)
//! follow: pending masks become memories; then frame by frame, each object that was not shown there:
//!     memories and pointers of frames before and of those that were shown --> mask --> memory, pointer
//! ```
//!
//! Objects do not know of each other; those that have equally many memories are computed together. A frame's features are computed once for
//! all of them.

use super::bank::ObjectMask;
use super::bank::{Entry, Object, Recall};
use super::prompts::{Frame, squared_mask};
use super::recall::Answer;
use super::{Features, Sam2, Sam2Error, prompts};
use crate::ops::tensor;
use crate::sam::Prompt;
use burn_core::tensor::Tensor;
use m4_core::{Plane, Progress, RgbImage};
use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::fmt;
use std::ops::{ControlFlow, RangeInclusive};
use std::sync::Arc;

/// Gives the image of a frame, by its number in the clip. Images may be of any size: all are squeezed to the network's square.
pub type ImageReader<'a> = Box<dyn Fn(usize) -> Result<RgbImage, Box<dyn Error + Send + Sync>> + Send + 'a>;

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
pub struct Clip {
    /// Frames.
    pub frames: usize,
    /// Columns that places of prompts are counted in, whatever the size of the images.
    pub width: usize,
    /// Rows, likewise.
    pub height: usize,
}

/// How objects are followed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VideoOptions {
    /// Holes of at most this many pixels of the logits are filled; 0 fills none. Upstream fills 8 where it runs on CUDA, and none elsewhere.
    pub fill_holes_px: usize,
    /// Whether a frame that an object is corrected in, after it was followed to it, counts as one that it was shown in first: later frames
    /// then never forget it. Upstream's is false.
    pub corrections_condition: bool,
    /// Frames that an object was shown in, at most, that another is seen in the light of: the nearest ones, at least 2. `None` takes all, as
    /// upstream does; each costs as much as a frame before.
    pub most_conditioning: Option<usize>,
    /// What was found is kept of frames that are so near to the last or to one that was shown. Less than 15 is 15 (6 for memories), which
    /// is what following needs; a correction farther off starts without the mask of before.
    pub history_frames: usize,
    /// Objects that are computed together, at most.
    pub together: usize,
}

impl Default for VideoOptions {
    fn default() -> Self {
        Self { fill_holes_px: 0, corrections_condition: false, most_conditioning: None, history_frames: 0, together: 4 }
    }
}

/// Frames whose features are kept.
const FEATURES: usize = 3;
/// The largest logit of an earlier mask that a prompt takes up, up or down.
const EARLIER_LOGIT: f32 = 32.0;

/// Follows objects through a clip.
///
/// What is kept does not grow with the clip but for two numbers an object and frame: a megabyte for each of six frames before the last,
/// a quarter of one for each of 15, and the same on both sides of each frame that an object was shown in.
pub struct VideoPredictor<'a> {
    pub(super) net: Arc<Sam2>,
    clip: Clip,
    frame: Frame,
    images: ImageReader<'a>,
    options: VideoOptions,
    pub(super) objects: BTreeMap<u32, Object>,
    /// The last ones last.
    features: Vec<(usize, Arc<Features>)>,
}

impl fmt::Debug for VideoPredictor<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("VideoPredictor")
            .field("clip", &self.clip)
            .field("options", &self.options)
            .field("objects", &self.objects.keys())
            .finish_non_exhaustive()
    }
}

impl<'a> VideoPredictor<'a> {
    /// For `clip`, whose images are asked for where they are needed.
    ///
    /// # Errors
    ///
    /// [`Sam2Error`] if the clip has no frames or no pixels.
    pub fn new(net: Arc<Sam2>, clip: Clip, images: ImageReader<'a>, options: VideoOptions) -> Result<Self, Sam2Error> {
        if clip.frames == 0 {
            return Err(Sam2Error::NoFrames);
        }
        Ok(Self {
            net,
            clip,
            frame: Frame::of("a clip", (clip.width, clip.height))?,
            images,
            options,
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
    /// [`Sam2Error::UnknownObject`] if it was never shown.
    pub fn remove(&mut self, object: u32) -> Result<(), Sam2Error> {
        let found = self.objects.remove(&object);
        found.map(drop).ok_or(Sam2Error::UnknownObject(object))
    }

    /// The mask of an object in a frame, if it is still known.
    ///
    /// # Errors
    ///
    /// [`Sam2Error`] if the object was never shown or the clip has no such frame.
    pub fn mask(&self, frame: usize, object: u32) -> Result<Option<ObjectMask>, Sam2Error> {
        self.check(frame)?;
        let object = self.objects.get(&object).ok_or(Sam2Error::UnknownObject(object))?;
        Ok(object.at(frame).map(|entry| entry.mask.clone()))
    }

    fn check(&self, frame: usize) -> Result<(), Sam2Error> {
        let frames = self.clip.frames;
        if frame < frames { Ok(()) } else { Err(Sam2Error::NoSuchFrame { frame, frames }) }
    }

    /// Shows an object in a frame by places, with a name of the caller's choice, or corrects it there; its mask in that frame. All places
    /// of the frame are given each time: they replace earlier ones. `mask_logits` of the prompt take the place of what was found in that
    /// frame before, which else counts. Other frames learn of it when they are [followed to](Self::follow).
    ///
    /// # Errors
    ///
    /// [`Sam2Error`] if the clip has no such frame, the prompt is empty or wrong, or the image or the device fails.
    pub fn show(&mut self, frame: usize, object: u32, prompt: &Prompt) -> Result<ObjectMask, Sam2Error> {
        self.check(frame)?;
        prompts::check(prompt)?;
        let net = Arc::clone(&self.net);
        let tokens = prompts::tokens(&net.net.prompt_encoder, prompt, self.frame, net.side)?;
        let given = prompt.mask_logits.as_ref();
        let known = self.objects.get(&object);
        let mask = match given.or_else(|| known?.logits(frame)) {
            Some(mask) => {
                let mask = prompts::mask(mask, net.mask_side(), &net.device)?;
                Some(mask.clamp(-EARLIER_LOGIT, EARLIER_LOGIT))
            }
            None => None,
        };
        let recall = known.and_then(|known| {
            let direction = *known.followed.get(&frame)?;
            let recall = known.recall(frame, direction, self.clip.frames, self.options.most_conditioning);
            (!recall.memories.is_empty()).then_some(recall)
        });
        let first = known.is_none_or(|known| !known.followed.contains_key(&frame));
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
    pub fn show_mask(&mut self, frame: usize, object: u32, mask: &Plane<bool>) -> Result<ObjectMask, Sam2Error> {
        self.check(frame)?;
        Frame::of("a mask", mask.size())?;
        let net = Arc::clone(&self.net);
        let features = self.features(frame)?;
        let known = self.objects.get(&object);
        let first = known.is_none_or(|known| !known.followed.contains_key(&frame));
        let answer = net.given(&features, squared_mask(mask, net.side))?;
        self.pend(frame, object, vec![answer], first)
    }

    /// Keeps what was shown, the first of `answers`, until objects are followed.
    fn pend(&mut self, frame: usize, object: u32, answers: Vec<Answer>, first: bool) -> Result<ObjectMask, Sam2Error> {
        let nothing = || Sam2Error::Device("no answer".to_owned());
        let answer = answers.into_iter().next().ok_or_else(nothing)?;
        let entry = Entry::of(answer, self.options.fill_holes_px, true)?;
        let mask = entry.mask.clone();
        let known = self.objects.entry(object).or_default();
        // what was shown first is corrected where it is
        let conditions = first || self.options.corrections_condition || known.conditioning.contains_key(&frame);
        known.pending.insert(frame, (entry, conditions));
        Ok(mask)
    }

    /// Follows all objects through `frames`, from the first to the last or from the last to the first; `each` gets the frame and the masks of
    /// all objects in it. What was shown in a frame is given as it was found there.
    ///
    /// # Errors
    ///
    /// [`Sam2Error`] if there is no object, the clip has no such frames, `progress` says to stop, or an image or the device fails. Frames
    /// that `each` got stay followed.
    pub fn follow(
        &mut self,
        frames: RangeInclusive<usize>,
        direction: Direction,
        progress: &dyn Progress,
        mut each: impl FnMut(usize, &BTreeMap<u32, ObjectMask>),
    ) -> Result<(), Sam2Error> {
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
    /// As [`Self::follow`]; [`Sam2Error::UnknownObject`] if one was never shown.
    pub fn follow_some(
        &mut self,
        objects: &[u32],
        frames: RangeInclusive<usize>,
        direction: Direction,
        progress: &dyn Progress,
        mut each: impl FnMut(usize, &BTreeMap<u32, ObjectMask>) -> ControlFlow<()>,
    ) -> Result<(), Sam2Error> {
        if objects.is_empty() {
            return Err(Sam2Error::NoObjects);
        }
        if let Some(&unknown) = objects.iter().find(|id| !self.objects.contains_key(id)) {
            return Err(Sam2Error::UnknownObject(unknown));
        }
        self.check(*frames.start())?;
        self.check(*frames.end())?;
        let some: BTreeSet<u32> = objects.iter().copied().collect();
        let total = frames.clone().count();
        self.settle(progress)?;
        for done in 0..total {
            if progress.cancelled() {
                return Err(Sam2Error::Cancelled);
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
    fn settle(&mut self, progress: &dyn Progress) -> Result<(), Sam2Error> {
        let net = Arc::clone(&self.net);
        let pending: Vec<(u32, usize)> = self
            .objects
            .iter()
            .flat_map(|(&id, object)| object.pending.keys().map(move |&frame| (id, frame)))
            .collect();
        for (id, frame) in pending {
            if progress.cancelled() {
                return Err(Sam2Error::Cancelled);
            }
            let features = self.features(frame)?;
            let Some(object) = self.objects.get_mut(&id) else {
                continue;
            };
            let Some((mut entry, conditions)) = object.pending.remove(&frame) else {
                continue;
            };
            let side = net.mask_side();
            let logits = tensor(entry.mask.logits.data().to_vec(), [1, side, side], &net.device);
            let enlarged = net.enlarged(logits);
            let mask = enlarged.clone().greater_elem(0.0).float().cast(enlarged.dtype());
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
    ) -> Result<BTreeMap<u32, ObjectMask>, Sam2Error> {
        let mut groups: BTreeMap<(usize, usize), Vec<(u32, Recall)>> = BTreeMap::new();
        for (&id, object) in &self.objects {
            if some.contains(&id) && object.shown(frame).is_none() {
                let recall = object.recall(frame, direction, self.clip.frames, self.options.most_conditioning);
                let size = (recall.memories.len(), recall.pointers.len());
                groups.entry(size).or_default().push((id, recall));
            }
        }
        if !groups.is_empty() {
            let net = Arc::clone(&self.net);
            let features = self.features(frame)?;
            let begun = net.begun(&features);
            for (_, group) in groups {
                for part in group.chunks(self.options.together.max(1)) {
                    let found = self.found(&net, &features, &begun, part)?;
                    for (id, entry) in found {
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
            object.forget(frame, self.options.history_frames);
            masks.extend(object.at(frame).map(|entry| (id, entry.mask.clone())));
        }
        Ok(masks)
    }

    /// Some objects, which have equally many memories, in a frame.
    fn found(
        &self,
        net: &Sam2,
        features: &Features,
        begun: &Tensor<3>,
        some: &[(u32, Recall)],
    ) -> Result<Vec<(u32, Entry)>, Sam2Error> {
        let recalls: Vec<Recall> = some.iter().map(|(_, recall)| recall.clone()).collect();
        let map = net.recalled(begun.clone(), &recalls, self.clip.frames);
        let answers = net.followed(map, features)?;
        let logits = answers.iter().map(|answer| answer.logits.clone()).collect();
        let there: Vec<bool> = answers.iter().map(|answer| answer.score > 0.0).collect();
        let masks = crate::ops::sigmoid(net.enlarged(Tensor::cat(logits, 0)));
        let memories = net.remembered(features, masks, &there);
        let mut found = Vec::new();
        for (i, (answer, (id, _))) in answers.into_iter().zip(some).enumerate() {
            let mut entry = Entry::of(answer, self.options.fill_holes_px, false)?;
            entry.memory = Some(memories.clone().narrow(0, i, 1));
            found.push((*id, entry));
        }
        Ok(found)
    }

    /// A frame's features.
    pub(super) fn features(&mut self, frame: usize) -> Result<Arc<Features>, Sam2Error> {
        if let Some(i) = self.features.iter().position(|(at, _)| *at == frame) {
            let kept = self.features.remove(i);
            let features = Arc::clone(&kept.1);
            self.features.push(kept);
            return Ok(features);
        }
        let image = (self.images)(frame).map_err(|reason| Sam2Error::Image { frame, reason })?;
        let features = Arc::new(self.net.encode(&image)?);
        if self.features.len() >= FEATURES {
            self.features.remove(0);
        }
        self.features.push((frame, Arc::clone(&features)));
        Ok(features)
    }
}
