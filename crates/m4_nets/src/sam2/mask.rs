//! The mask of an object.

use super::preprocess::stretched;
use m4_core::Plane;

/// The mask of an object in an image.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectMask {
    /// `[256][256]` (or [as many](super::Sam2::mask_side) as the network's side gives), over the whole image, which is squeezed to that
    /// square: above 0 where the object is. May be part of another [`Prompt`](crate::Prompt). All -1024 where a clip's object is
    /// not there.
    pub logits: Plane<f32>,
    /// How well the network thinks that the mask fits: its intersection with the true one over their union, from 0 to 1.
    pub iou: f32,
    /// The `iou` of all masks that this one was chosen from: three where the prompt was ambiguous or there was none, else its own.
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

    /// The logits for an image of `size`, columns and rows, bilinear; empty where that has no pixels.
    #[must_use]
    pub fn logits_at(&self, size: (usize, usize)) -> Plane<f32> {
        if size.0.min(size.1) == 0 || self.logits.data().is_empty() {
            return Plane::filled(size.0, size.1, super::ABSENT);
        }
        stretched(&self.logits, size)
    }

    /// Where the object is in an image of `size`, columns and rows.
    #[must_use]
    pub fn mask_at(&self, size: (usize, usize)) -> Plane<bool> {
        self.logits_at(size).map(|&x| x > 0.0)
    }
}
