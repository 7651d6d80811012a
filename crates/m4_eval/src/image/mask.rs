//! Prepares masks for scoring.

use m4_core::{Mask, Plane};

/// The mask grown by `radius_px` in every direction (a square of side `2 radius + 1`).
#[must_use]
pub fn dilated(mask: &Mask, radius_px: usize) -> Mask {
    let (width, height) = mask.size();
    let grown = m4_core::dilated(mask.data(), width, height, radius_px);
    Plane::from_fn(width, height, |x, y| grown[y * width + x])
}

#[cfg(test)]
mod tests {
    use super::dilated;
    use m4_core::Plane;

    #[test]
    fn dilation_grows_a_square() {
        let dot = Plane::from_fn(9, 9, |x, y| if (x, y) == (4, 1) { 255 } else { 0 });
        let grown = dilated(&dot, 2);
        let count = grown.data().iter().filter(|&&m| m == 255).count();
        assert_eq!(count, 5 * 4);
        assert_eq!(dilated(&dot, 0), dot);
    }
}
