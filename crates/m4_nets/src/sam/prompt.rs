//! What is asked for.

use m4_core::Plane;

/// A place in an image, and whether it belongs to the object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointPrompt {
    /// Column and row in pixels of the image; the centre of its first pixel is (0.5, 0.5).
    pub at_px: [f32; 2],
    /// Whether the object is there.
    pub on_object: bool,
}

/// What is known of an object; at least one of the three.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Prompt {
    /// Places on the object and off it.
    pub points: Vec<PointPrompt>,
    /// A box around it: column and row of the centre of its first pixel, then of its last, as for points.
    pub box_px: Option<[f32; 4]>,
    /// The `logits` of an earlier [`MaskPrediction`](crate::MaskPrediction) of the same image, `[256][256]`.
    pub mask_logits: Option<Plane<f32>>,
}

impl Prompt {
    /// Whether several objects may be meant, a part or the whole: at most one point and no box.
    #[must_use]
    pub fn is_ambiguous(&self) -> bool {
        self.points.len() < 2 && self.box_px.is_none()
    }
}
