//! Masks that the caller provides.

use super::DenseError;
use m4_core::Mask;

/// Rejects masks of another clip.
pub(super) fn check(masks: Option<&[Mask]>, frames: usize) -> Result<(), DenseError> {
    match masks.map(<[_]>::len).filter(|&n| n != frames) {
        Some(found) => Err(DenseError::Given {
            what: "masks",
            found,
            expected: frames,
        }),
        None => Ok(()),
    }
}

/// The mask at the working size, 255 in dynamic regions, read at the nearest pixel.
pub(super) fn at_size(mask: &Mask, width: usize, height: usize) -> Vec<u8> {
    let at = nearest(mask.size(), width, height);
    (0..width * height)
        .map(|p| if mask[at(p)] > 0 { 255 } else { 0 })
        .collect()
}

/// The pixel of a plane of size `from` at the centre of pixel `p` of one of `width` x `height`.
pub(super) fn nearest(from: (usize, usize), width: usize, height: usize) -> impl Fn(usize) -> (usize, usize) {
    move |p| {
        let (x, y) = (p % width, p / width);
        ((2 * x + 1) * from.0 / (2 * width), (2 * y + 1) * from.1 / (2 * height))
    }
}
