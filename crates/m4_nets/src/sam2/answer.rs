//! From what the decoder says to one mask an object: which of the four it is, whether the object is there, and the pointer that stands
//! for it.

use super::decoder::{Decoded, MASKS};
use super::{ABSENT, Sam2, Sam2Error, numbers};
use burn_core::tensor::{DType, Tensor};

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
    ///
    /// # Errors
    ///
    /// [`Sam2Error::Device`] if the device fails.
    pub(super) fn answers(&self, decoded: Decoded, ambiguous: bool) -> Result<Vec<Answer>, Sam2Error> {
        let [b, _, rows, columns] = decoded.masks.dims();
        let masks = decoded.masks.cast(DType::F32);
        let iou = numbers(decoded.iou)?;
        let scores = numbers(decoded.score)?;
        let stability = if ambiguous { vec![1.0; b] } else { numbers(stability(&masks))? };
        let mut answers = Vec::new();
        for (i, iou) in iou.chunks_exact(MASKS).enumerate() {
            let chosen = chosen(iou, ambiguous, stability[i]);
            let token = if ambiguous { chosen } else { 0 };
            let token = decoded.tokens.clone().narrow(0, i, 1).narrow(1, token, 1);
            let there = scores[i] > 0.0;
            answers.push(Answer {
                logits: if there {
                    masks.clone().narrow(0, i, 1).narrow(1, chosen, 1).squeeze_dim(1)
                } else {
                    Tensor::full([1, rows, columns], ABSENT, (&masks.device(), DType::F32))
                },
                pointer: if there {
                    self.net.obj_ptr_proj.forward(token.squeeze_dim(1))
                } else {
                    self.net.no_obj_ptr.val()
                },
                score: scores[i],
                iou: iou[chosen],
                candidates: if ambiguous { iou[1..].to_vec() } else { vec![iou[chosen]] },
            });
        }
        Ok(answers)
    }
}

/// Which of four masks is taken: the best of the three readings where the prompt is ambiguous or the first mask is unstable.
pub fn chosen(iou: &[f32], ambiguous: bool, stability: f32) -> usize {
    if !ambiguous && stability >= LEAST_STABLE {
        return 0;
    }
    let better = |best: usize, i: usize| if iou[i] > iou[best] { i } else { best };
    (2..iou.len()).fold(1, better)
}

/// The share of the first mask's area that stays when logits are a little less, `[b]`; 1 where there is none.
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
