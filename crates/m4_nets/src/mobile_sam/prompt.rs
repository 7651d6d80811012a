//! Prompts and their encoding: points and boxes as tokens, an earlier mask as a map.

use super::SamError;
use super::preprocess::{EMBEDDING_SIDE, INPUT_SIDE, MASK_SIDE, Scale};
use crate::ops::tensor;
use crate::sam::{Prompt, PromptEncoder};
use burn_core::tensor::{Device, Tensor};

/// Whether `prompt` asks for something in an image that lies so.
fn check(prompt: &Prompt, scale: Scale) -> Result<(), SamError> {
    if prompt.points.is_empty() && prompt.box_px.is_none() && prompt.mask_logits.is_none() {
        return Err(SamError::NothingAsked);
    }
    for point in &prompt.points {
        scale.check(point.at_px)?;
    }
    if let Some([x0, y0, x1, y1]) = prompt.box_px {
        scale.check([x0, y0])?;
        scale.check([x1, y1])?;
        if x1 < x0 || y1 < y0 {
            return Err(SamError::Reversed([x0, y0, x1, y1]));
        }
    }
    match &prompt.mask_logits {
        Some(mask) if mask.size() != (MASK_SIDE, MASK_SIDE) => {
            Err(SamError::MaskSize { width: mask.width(), height: mask.height() })
        }
        Some(mask) if !mask.data().iter().all(|x| x.is_finite()) => Err(SamError::NotFinite),
        _ => Ok(()),
    }
}

/// Tokens `[n, 256]` for the points and the box of `prompt`, if it has any, and what is added to the embedding: `[256, 64, 64]`, or
/// `[256, 1, 1]` without a mask.
///
/// # Errors
///
/// [`SamError`] if nothing is asked, a place is not in the image, the box is reversed, or the mask has another size or numbers that
/// are not finite.
pub fn encoded(
    encoder: &PromptEncoder,
    prompt: &Prompt,
    scale: Scale,
    device: &Device,
) -> Result<(Option<Tensor<2>>, Tensor<3>), SamError> {
    check(prompt, scale)?;
    let mut tokens = Vec::new();
    let token =
        |at_px: [f32; 2], kind: usize| encoder.place(scale.to_input(at_px).map(|x| x / INPUT_SIDE as f32), kind);
    for point in &prompt.points {
        tokens.push(token(point.at_px, usize::from(point.on_object)));
    }
    match prompt.box_px {
        Some([x0, y0, x1, y1]) => tokens.extend([token([x0, y0], 2), token([x1, y1], 3)]),
        // points are never alone
        None if tokens.is_empty() => {}
        None => tokens.push(encoder.nowhere()),
    }
    let tokens = (!tokens.is_empty()).then(|| Tensor::cat(tokens, 0));
    let mask = prompt.mask_logits.as_ref();
    let mask = mask.map(|mask| tensor(mask.data().to_vec(), [1, 1, MASK_SIDE, MASK_SIDE], device));
    Ok((tokens, encoder.mask(mask).squeeze_dim(0)))
}

/// Where the pixels of the embedding are, row by row: `[64 * 64, 256]`.
pub fn grid(encoder: &PromptEncoder, device: &Device) -> Tensor<2> {
    encoder.grid([EMBEDDING_SIDE, EMBEDDING_SIDE], device)
}
