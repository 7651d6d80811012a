//! Rotates images upright: the eight ways in which a display matrix can rotate and mirror.

use m4_core::{Plane, RgbImage};

/// Where the stored image's columns and rows go on the display.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Orientation {
    /// Stored columns become displayed rows.
    transpose: bool,
    /// Displayed columns run against the stored axis they come from.
    flip_x: bool,
    /// Displayed rows run against the stored axis they come from.
    flip_y: bool,
}

impl Orientation {
    /// From the display matrix of a track (`x' = a x + c y + ..`, `y' = b x + d y + ..`, y down). `None`
    /// for matrices that are not one of the eight up to scale.
    pub fn from_matrix([a, b, _, c, d, _, _, _, _]: [i32; 9]) -> Option<Self> {
        // Rounding of turned matrices leaves a few units where 0 is meant (65536 = 1).
        let small = |v: i32| v.unsigned_abs() < 1024;
        if small(b) && small(c) && !small(a) && !small(d) {
            Some(Self { transpose: false, flip_x: a < 0, flip_y: d < 0 })
        } else if small(a) && small(d) && !small(b) && !small(c) {
            // x' follows y with the sign of c, y' follows x with the sign of b.
            Some(Self { transpose: true, flip_x: c < 0, flip_y: b < 0 })
        } else {
            None
        }
    }

    /// True when width and height change places.
    pub fn swaps_sides(self) -> bool {
        self.transpose
    }

    /// The image as it is displayed.
    pub fn apply(self, image: RgbImage) -> RgbImage {
        if self == (Self { transpose: false, flip_x: false, flip_y: false }) {
            return image;
        }
        let (w, h) = image.size();
        let (width, height) = if self.transpose { (h, w) } else { (w, h) };
        Plane::from_fn(width, height, |x, y| {
            let x = if self.flip_x { width - 1 - x } else { x };
            let y = if self.flip_y { height - 1 - y } else { y };
            image[if self.transpose { (y, x) } else { (x, y) }]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::Orientation;

    #[test]
    fn other_display_matrices_have_no_orientation() {
        assert_eq!(Orientation::from_matrix([46341, 46341, 0, -46341, 46341, 0, 0, 0, 1 << 30]), None);
        assert_eq!(Orientation::from_matrix([0; 9]), None);
    }
}
