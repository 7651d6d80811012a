//! What is asked for, checked and encoded.

use super::Sam2Error;
use super::preprocess::Frame;
use crate::ops::tensor;
use crate::sam::{Prompt, PromptEncoder};
use burn_core::tensor::{Device, Tensor};
use m4_core::Plane;

/// Tokens `[n, 256]` of `prompt` in an image of the size `frame`: the box's corners, the points, and one that is no place; two of those
/// where there are neither.
///
/// # Errors
///
/// [`Sam2Error`] if a place is not in the image or the box is reversed.
pub fn tokens(encoder: &PromptEncoder, prompt: &Prompt, frame: Frame, side: usize) -> Result<Tensor<2>, Sam2Error> {
    let mut tokens = Vec::new();
    if let Some([x0, y0, x1, y1]) = prompt.box_px {
        tokens.push(encoder.place(frame.place([x0, y0], side)?, 2));
        tokens.push(encoder.place(frame.place([x1, y1], side)?, 3));
        if x1 < x0 || y1 < y0 {
            return Err(Sam2Error::Reversed([x0, y0, x1, y1]));
        }
    }
    for point in &prompt.points {
        let at = frame.place(point.at_px, side)?;
        tokens.push(encoder.place(at, usize::from(point.on_object)));
    }
    if tokens.is_empty() {
        tokens.push(encoder.nowhere());
    }
    tokens.push(encoder.nowhere());
    Ok(Tensor::cat(tokens, 0))
}

/// The logits of a prompt's mask, `[1, 1, 4 h, 4 w]`.
///
/// # Errors
///
/// [`Sam2Error`] if it has another size than `side` or numbers that are not finite.
pub fn mask(mask: &Plane<f32>, side: usize, device: &Device) -> Result<Tensor<4>, Sam2Error> {
    if mask.size() != (side, side) {
        return Err(Sam2Error::MaskSize { width: mask.width(), height: mask.height(), expected: side });
    }
    if !mask.data().iter().all(|x| x.is_finite()) {
        return Err(Sam2Error::NotFinite);
    }
    Ok(tensor(mask.data().to_vec(), [1, 1, side, side], device))
}

/// Whether `prompt` asks for something.
///
/// # Errors
///
/// [`Sam2Error::NothingAsked`] if not.
pub fn check(prompt: &Prompt) -> Result<(), Sam2Error> {
    if prompt.points.is_empty() && prompt.box_px.is_none() && prompt.mask_logits.is_none() {
        return Err(Sam2Error::NothingAsked);
    }
    Ok(())
}
