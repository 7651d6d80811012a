//! What is kept of an object: its masks, pointers and memories, and which of them another frame is
//! seen in the light of.

use super::recall::Answer;
use super::video::Direction;
use super::{MEMORIES, plane, prompts};
use crate::NetError;
use crate::ops::bilinear_plane;
use burn_core::tensor::Tensor;
use m4_core::Plane;
use std::collections::BTreeMap;

/// Frames before another whose memories it is seen in the light of.
const MEMORY_FRAMES: usize = MEMORIES - 1;
/// The same of pointers.
const POINTER_FRAMES: usize = 15;

/// An object in a frame.
#[derive(Debug, Clone)]
pub struct Entry {
    pub mask: ObjectMask,
    /// `[1, 256]`.
    pub pointer: Tensor<2>,
    /// `[1, n, 64]`; `None` before it is encoded, and where it is too far from everything.
    pub memory: Option<Tensor<3>>,
    /// Whether the caller showed it.
    pub prompted: bool,
}

impl Entry {
    /// What was found, without a memory; holes of at most `holes_px` pixels are filled.
    pub fn of(answer: Answer, holes_px: usize, prompted: bool) -> Result<Self, NetError> {
        let mut logits = plane(answer.logits)?;
        prompts::fill(&mut logits, holes_px);
        Ok(Self {
            mask: ObjectMask {
                logits,
                iou: answer.iou,
                candidates: answer.candidates,
                score: answer.score,
            },
            pointer: answer.pointer,
            memory: None,
            prompted,
        })
    }
}

/// What a frame is seen in the light of.
#[derive(Debug, Clone, Default)]
pub struct Recall {
    /// Memories, and which of the temporal positions each has.
    pub memories: Vec<(usize, Tensor<3>)>,
    /// Pointers, and how many frames ago.
    pub pointers: Vec<(usize, Tensor<2>)>,
}

/// An object of a clip, by frames.
#[derive(Debug, Clone, Default)]
pub struct Object {
    /// Where the caller showed it first.
    pub conditioning: BTreeMap<usize, Entry>,
    /// Where it was followed to, or corrected.
    pub others: BTreeMap<usize, Entry>,
    /// What was shown since it was last followed, and whether that belongs to the first.
    pub pending: BTreeMap<usize, (Entry, bool)>,
    /// Frames that it was followed to, and in which direction.
    pub followed: BTreeMap<usize, Direction>,
}

impl Object {
    /// What is known of it in a frame, the newest.
    pub fn at(&self, frame: usize) -> Option<&Entry> {
        let pending = self.pending.get(&frame).map(|(entry, _)| entry);
        let settled = || {
            self.conditioning
                .get(&frame)
                .or_else(|| self.others.get(&frame))
        };
        pending.or_else(settled)
    }

    /// What was shown in a frame, and is not found again.
    pub fn shown(&self, frame: usize) -> Option<&Entry> {
        let corrected = || self.others.get(&frame).filter(|entry| entry.prompted);
        self.conditioning.get(&frame).or_else(corrected)
    }

    /// Puts what was shown in a frame, now with a memory, where it belongs.
    pub fn settle(&mut self, frame: usize, entry: Entry, conditions: bool) {
        if conditions {
            self.others.remove(&frame);
            self.conditioning.insert(frame, entry);
        } else {
            self.others.insert(frame, entry);
        }
    }

    /// What `frame` of a clip of `frames` is seen in the light of when following in `direction`.
    pub fn recall(&self, frame: usize, direction: Direction, frames: usize) -> Recall {
        let other = |at: usize| self.others.get(&at);
        let before = |steps: usize| direction.before(frame, steps).filter(|&at| at < frames);
        let mut recall = Recall::default();
        for entry in self.conditioning.values() {
            recall
                .memories
                .extend(entry.memory.clone().map(|m| (MEMORIES - 1, m)));
        }
        for steps in (1..=MEMORY_FRAMES).rev() {
            let memory = before(steps)
                .and_then(other)
                .and_then(|entry| entry.memory.clone());
            recall.memories.extend(memory.map(|m| (steps - 1, m)));
        }
        for (&at, entry) in &self.conditioning {
            let past = match direction {
                Direction::Forward => at <= frame,
                Direction::Backward => at >= frame,
            };
            if past {
                recall
                    .pointers
                    .push((frame.abs_diff(at), entry.pointer.clone()));
            }
        }
        for steps in 1..pointer_frames(frames) {
            let Some(at) = before(steps) else { break };
            recall
                .pointers
                .extend(other(at).map(|entry| (steps, entry.pointer.clone())));
        }
        recall
    }

    /// Forgets what no frame near `head` or near one that the caller prompted is seen in the light
    /// of.
    pub fn forget(&mut self, head: usize) {
        let shown = self.conditioning.keys().chain(self.pending.keys()).copied();
        let anchors: Vec<usize> = shown.chain([head]).collect();
        let near =
            |at: usize, reach: usize| anchors.iter().any(|&anchor| anchor.abs_diff(at) <= reach);
        self.others
            .retain(|&at, entry| entry.prompted || near(at, POINTER_FRAMES));
        for (&at, entry) in &mut self.others {
            if !entry.prompted && !near(at, MEMORY_FRAMES) {
                entry.memory = None;
            }
        }
    }
}

/// Pointers that a frame of a clip of `frames` may be seen in the light of, its own among them.
pub fn pointer_frames(frames: usize) -> usize {
    frames.min(POINTER_FRAMES + 1)
}

/// The mask of an object in an image.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectMask {
    /// `[256][256]` (or as many as the network's side gives), over the whole image, which is
    /// squeezed to that square: above 0 where the object is. May be part of another
    /// [`Prompt`](crate::Prompt). All -1024 where a clip's object is not there.
    pub logits: Plane<f32>,
    /// How well the network thinks that the mask fits: its intersection with the true one over
    /// their union, from 0 to 1.
    pub iou: f32,
    /// The `iou` of all masks that this one was chosen from: three where the prompt was ambiguous
    /// or there was none, else its own.
    pub candidates: Vec<f32>,
    /// Whether the network thinks that the object is in the image: the more above 0, the surer.
    pub score: f32,
}

impl ObjectMask {
    /// Whether the object is in the image at all.
    #[must_use]
    pub fn is_there(&self) -> bool {
        self.score > 0.0
    }

    /// The logits for an image of `size`, columns and rows, bilinear; empty where that has no
    /// pixels.
    #[must_use]
    pub fn logits_at(&self, size: (usize, usize)) -> Plane<f32> {
        if size.0.min(size.1) == 0 || self.logits.data().is_empty() {
            return Plane::filled(size.0, size.1, super::ABSENT);
        }
        bilinear_plane(&self.logits, size)
    }

    /// Where the object is in an image of `size`, columns and rows.
    #[must_use]
    pub fn mask_at(&self, size: (usize, usize)) -> Plane<bool> {
        self.logits_at(size).map(|&x| x > 0.0)
    }
}
