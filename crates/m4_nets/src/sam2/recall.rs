//! What the network makes of memories.
//!
//! ```text
//! memories (64 wide, with their place and age) and pointers --> attention of a frame's features --> features that know the object
//! a mask that was given --> logits and a pointer, as if it had been found
//! ```

use super::bank::{Recall, pointer_frames};
use super::decoder::{Decoded, MASKS};
use super::memory::{MEMORY_WIDTH, Memories};
use super::{ABSENT, Features, Sam2};
use crate::NetError;
use crate::error::numbers;
use crate::ops::{Kernels, resampled, tensor};
use crate::sam::WIDTH;
use burn_core::tensor::{DType, Tensor};

impl Sam2 {
    /// A frame's features after what of memory attention depends on the frame alone.
    pub(super) fn begun(&self, features: &Features) -> Tensor<3> {
        let tables = &self.tables;
        let attention = &self.net.memory_attention;
        attention.begun(features.map.clone(), &tables.sine, &tables.rotations)
    }

    /// The same in the light of memories, of which all `recalls` have equally many, at least one:
    /// `[b, n, 256]`.
    pub(super) fn recalled(
        &self,
        begun: Tensor<3>,
        recalls: &[Recall],
        frames: usize,
    ) -> Tensor<3> {
        let (mut values, mut keys) = (Vec::new(), Vec::new());
        for recall in recalls {
            let [value, key] = self.memories(recall, frames);
            values.push(value);
            keys.push(key);
        }
        let placed = recalls.first().map_or(0, |recall| recall.memories.len());
        let memories = Memories {
            values: Tensor::cat(values, 0),
            keys: Tensor::cat(keys, 0),
            placed: placed * self.tables.grid * self.tables.grid,
        };
        let attention = &self.net.memory_attention;
        attention.forward(begun, &memories, &self.tables.rotations)
    }

    /// Memories and pointers one after the other, `[1, m, 64]`, without and with their positions.
    fn memories(&self, recall: &Recall, frames: usize) -> [Tensor<3>; 2] {
        let (mut values, mut places) = (Vec::new(), Vec::new());
        for (time, memory) in &recall.memories {
            let time = self.net.maskmem_tpos_enc.val().narrow(0, *time, 1);
            values.push(memory.clone());
            places.push(self.tables.memory_sine.clone() + time.reshape([1, 1, MEMORY_WIDTH]));
        }
        if !recall.pointers.is_empty() {
            let count = recall.pointers.len();
            let parts = WIDTH / MEMORY_WIDTH;
            let pointers = recall
                .pointers
                .iter()
                .map(|(_, pointer)| pointer.clone())
                .collect();
            let pointers: Tensor<2> = Tensor::cat(pointers, 0);
            values.push(pointers.reshape([1, count * parts, MEMORY_WIDTH]));
            let most = (pointer_frames(frames) - 1).max(1) as f32;
            let times = recall
                .pointers
                .iter()
                .flat_map(|(steps, _)| waves(*steps as f32 / most));
            let times = tensor(times.collect(), [count, WIDTH], &self.device).cast(self.dtype);
            let times = self.net.obj_ptr_tpos_proj.forward(times);
            let times =
                times
                    .reshape([count, 1, MEMORY_WIDTH])
                    .expand([count, parts, MEMORY_WIDTH]);
            places.push(times.reshape([1, count * parts, MEMORY_WIDTH]));
        }
        let values = Tensor::cat(values, 1);
        [values.clone(), values + Tensor::cat(places, 1)]
    }

    /// A frame's features where nothing is remembered.
    pub(super) fn unremembered(&self, features: &Features) -> Tensor<3> {
        features.map.clone() + self.net.no_mem_embed.val()
    }

    /// The answer that a mask stands for; the mask is of the image's square, 1 where the object is.
    pub(super) fn answer_of_mask(
        &self,
        features: &Features,
        mask: Vec<f32>,
    ) -> Result<Answer, NetError> {
        let (side, small) = (self.side, self.mask_side());
        let present = mask.iter().any(|&x| x > 0.0);
        let logits: Vec<f32> = mask.iter().map(|x| 20.0 * x - 10.0).collect();
        let smaller = Kernels::triangle(side, small);
        let logits = resampled(&logits, side, side, &smaller, &smaller);
        let pointer = if present {
            let mask = tensor(mask, [1, 1, side, side], &self.device).cast(self.dtype);
            let mask = self.net.mask_downsample.forward(mask);
            let nowhere = self.net.prompt_encoder.nowhere();
            let tokens = Tensor::cat(vec![nowhere.clone(), nowhere], 0).unsqueeze_dim(0);
            let mask = mask.cast(DType::F32);
            let decoded = self.decoded(features.map.clone(), features, tokens, Some(mask));
            let mut answers = self.answers(decoded, false)?;
            answers.pop().map(|answer| answer.pointer)
        } else {
            None
        };
        Ok(Answer {
            logits: tensor(logits, [1, small, small], &self.device),
            pointer: pointer.unwrap_or_else(|| self.net.no_obj_ptr.val()),
            score: if present { 10.0 } else { -10.0 },
            iou: 1.0,
            candidates: vec![1.0],
        })
    }
}

/// A time as sines and cosines, 128 each, neighbours of the same wavelength.
fn waves(time: f32) -> impl Iterator<Item = f32> {
    let half = WIDTH / 2;
    let angle = move |i: usize| time / 10_000f32.powf((i / 2 * 2) as f32 / half as f32);
    (0..half)
        .map(move |i| angle(i).sin())
        .chain((0..half).map(move |i| angle(i).cos()))
}

/// How far logits move where a mask is asked for its stability.
const MOVED: f32 = 0.05;
/// The least share of its area that stays where a mask is stable.
const LEAST_STABLE: f32 = 0.98;

/// What is found of one object.
#[derive(Debug, Clone)]
pub struct Answer {
    /// Logits `[1, 4 h, 4 w]`, in 32 bits.
    pub logits: Tensor<3>,
    /// `[1, 256]`.
    pub pointer: Tensor<2>,
    /// Above 0 where the object is in the image.
    pub score: f32,
    /// How good the mask is thought to be, and those that it was chosen from.
    pub iou: f32,
    /// Three, or the one.
    pub candidates: Vec<f32>,
}

impl Sam2 {
    /// One mask of each of `b` prompts; `ambiguous` if the best of three readings is to be taken.
    pub(super) fn answers(
        &self,
        decoded: Decoded,
        ambiguous: bool,
    ) -> Result<Vec<Answer>, NetError> {
        let [b, _, rows, columns] = decoded.masks.dims();
        let masks = decoded.masks.cast(DType::F32);
        let iou = numbers(decoded.iou)?;
        let scores = numbers(decoded.score)?;
        let stability = if ambiguous {
            vec![1.0; b]
        } else {
            numbers(stability(&masks))?
        };
        let mut answers = Vec::new();
        for (i, iou) in iou.chunks_exact(MASKS).enumerate() {
            let chosen = chosen(iou, ambiguous, stability[i]);
            let token = if ambiguous { chosen } else { 0 };
            let token = decoded.tokens.clone().narrow(0, i, 1).narrow(1, token, 1);
            let present = scores[i] > 0.0;
            answers.push(Answer {
                logits: if present {
                    masks
                        .clone()
                        .narrow(0, i, 1)
                        .narrow(1, chosen, 1)
                        .squeeze_dim(1)
                } else {
                    Tensor::full([1, rows, columns], ABSENT, (&masks.device(), DType::F32))
                },
                pointer: if present {
                    self.net.obj_ptr_proj.forward(token.squeeze_dim(1))
                } else {
                    self.net.no_obj_ptr.val()
                },
                score: scores[i],
                iou: iou[chosen],
                candidates: if ambiguous {
                    iou[1..].to_vec()
                } else {
                    vec![iou[chosen]]
                },
            });
        }
        Ok(answers)
    }
}

/// Which of four masks is taken: the best of the three readings where the prompt is ambiguous or
/// the first mask is unstable.
pub fn chosen(iou: &[f32], ambiguous: bool, stability: f32) -> usize {
    if !ambiguous && stability >= LEAST_STABLE {
        return 0;
    }
    let better = |best: usize, i: usize| if iou[i] > iou[best] { i } else { best };
    (2..iou.len()).fold(1, better)
}

/// The share of the first mask's area that stays when logits are a little less, `[b]`; 1 where
/// there is none.
pub fn stability(masks: &Tensor<4>) -> Tensor<1> {
    let [b, _, h, w] = masks.dims();
    let first = masks.clone().narrow(1, 0, 1).reshape([b, h * w]);
    let dtype = first.dtype();
    let area = |above: f32| -> Tensor<1> {
        let over = first.clone().greater_elem(above).float().cast(dtype);
        over.sum_dim(1).squeeze_dim(1)
    };
    let outer = area(-MOVED);
    let none = outer.clone().equal_elem(0.0);
    (area(MOVED) / outer).mask_fill(none, 1.0)
}
