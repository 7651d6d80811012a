//! What the network makes of memories.
//!
//! ```text
//! memories (64 wide, with their place and age) and pointers --> attention of a frame's features --> features that know the object
//! a mask that was given --> logits and a pointer, as if it had been found
//! ```

use super::answer::Answer;
use super::bank::{Recall, pointer_frames};
use super::memory_attention::{MEMORY_WIDTH, Memories};
use super::{Features, Sam2, Sam2Error};
use crate::ops::{Kernels, resampled, tensor};
use crate::sam::WIDTH;
use burn_core::tensor::Tensor;

impl Sam2 {
    /// A frame's features after what of memory attention depends on the frame alone.
    pub(super) fn begun(&self, features: &Features) -> Tensor<3> {
        let tables = &self.tables;
        let attention = &self.net.memory_attention;
        attention.begun(features.map.clone(), &tables.sine, &tables.rotations)
    }

    /// The same in the light of memories, of which all `recalls` have equally many, at least one: `[b, n, 256]`.
    pub(super) fn recalled(&self, begun: Tensor<3>, recalls: &[Recall], frames: usize) -> Tensor<3> {
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
            let pointers = recall.pointers.iter().map(|(_, pointer)| pointer.clone()).collect();
            let pointers: Tensor<2> = Tensor::cat(pointers, 0);
            values.push(pointers.reshape([1, count * parts, MEMORY_WIDTH]));
            let most = (pointer_frames(frames) - 1).max(1) as f32;
            let times = recall.pointers.iter().flat_map(|(steps, _)| waves(*steps as f32 / most));
            let times = tensor(times.collect(), [count, WIDTH], &self.device).cast(self.dtype);
            let times = self.net.obj_ptr_tpos_proj.forward(times);
            let times = times.reshape([count, 1, MEMORY_WIDTH]).expand([count, parts, MEMORY_WIDTH]);
            places.push(times.reshape([1, count * parts, MEMORY_WIDTH]));
        }
        let values = Tensor::cat(values, 1);
        [values.clone(), values + Tensor::cat(places, 1)]
    }

    /// A frame's features where nothing is remembered.
    pub(super) fn unremembered(&self, features: &Features) -> Tensor<3> {
        features.map.clone() + self.net.no_mem_embed.val()
    }

    /// What a mask of the image's square, 1 where the object is, stands for.
    pub(super) fn given(&self, features: &Features, mask: Vec<f32>) -> Result<Answer, Sam2Error> {
        let (side, small) = (self.side, self.mask_side());
        let there = mask.iter().any(|&x| x > 0.0);
        let logits: Vec<f32> = mask.iter().map(|x| 20.0 * x - 10.0).collect();
        let smaller = Kernels::triangle(side, small);
        let logits = resampled(&logits, side, side, &smaller, &smaller);
        let pointer = if there {
            let mask = tensor(mask, [1, 1, side, side], &self.device).cast(self.dtype);
            let mask = self.net.mask_downsample.forward(mask);
            let nowhere = self.net.prompt_encoder.nowhere();
            let tokens = Tensor::cat(vec![nowhere.clone(), nowhere], 0).unsqueeze_dim(0);
            let mask = mask.cast(burn_core::tensor::DType::F32);
            let decoded = self.decoded(features.map.clone(), features, tokens, Some(mask));
            let mut answers = self.answers(decoded, false)?;
            answers.pop().map(|answer| answer.pointer)
        } else {
            None
        };
        Ok(Answer {
            logits: tensor(logits, [1, small, small], &self.device),
            pointer: pointer.unwrap_or_else(|| self.net.no_obj_ptr.val()),
            score: if there { 10.0 } else { -10.0 },
            iou: 1.0,
            candidates: vec![1.0],
        })
    }
}

/// A time as sines and cosines, 128 each, neighbours of the same wavelength.
fn waves(time: f32) -> impl Iterator<Item = f32> {
    let half = WIDTH / 2;
    let angle = move |i: usize| time / 10_000f32.powf((i / 2 * 2) as f32 / half as f32);
    (0..half).map(move |i| angle(i).sin()).chain((0..half).map(move |i| angle(i).cos()))
}
