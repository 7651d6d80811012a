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
            Some(Self {
                transpose: false,
                flip_x: a < 0,
                flip_y: d < 0,
            })
        } else if small(a) && small(d) && !small(b) && !small(c) {
            // x' follows y with the sign of c, y' follows x with the sign of b.
            Some(Self {
                transpose: true,
                flip_x: c < 0,
                flip_y: b < 0,
            })
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
        if self
            == (Self {
                transpose: false,
                flip_x: false,
                flip_y: false,
            })
        {
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
    use m4_core::Plane;

    const ONE: i32 = 65536;

    fn turned(a: i32, b: i32, c: i32, d: i32) -> Vec<u8> {
        let matrix = [a * ONE, b * ONE, 0, c * ONE, d * ONE, 0, 0, 0, 1 << 30];
        let image = Plane::from_fn(3, 2, |x, y| [(1 + x + 3 * y) as u8; 3]);
        let got = Orientation::from_matrix(matrix).unwrap().apply(image);
        assert_eq!(got.size(), if b == 0 { (3, 2) } else { (2, 3) });
        got.data().iter().map(|p| p[0]).collect()
    }

    #[test]
    fn all_eight_orientations() {
        // Stored:  1 2 3
        //          4 5 6
        assert_eq!(turned(1, 0, 0, 1), [1, 2, 3, 4, 5, 6]);
        // A phone held upright: 90 degrees clockwise, x' = -y, y' = x.
        assert_eq!(turned(0, 1, -1, 0), [4, 1, 5, 2, 6, 3]);
        assert_eq!(turned(-1, 0, 0, -1), [6, 5, 4, 3, 2, 1]);
        assert_eq!(turned(0, -1, 1, 0), [3, 6, 2, 5, 1, 4]);
        assert_eq!(turned(-1, 0, 0, 1), [3, 2, 1, 6, 5, 4]);
        assert_eq!(turned(1, 0, 0, -1), [4, 5, 6, 1, 2, 3]);
        assert_eq!(turned(0, 1, 1, 0), [1, 4, 2, 5, 3, 6]);
        assert_eq!(turned(0, -1, -1, 0), [6, 3, 5, 2, 4, 1]);
    }

    #[test]
    fn unknown_colour_matrices_are_refused() {
        assert_eq!(
            Orientation::from_matrix([46341, 46341, 0, -46341, 46341, 0, 0, 0, 1 << 30]),
            None
        );
        assert_eq!(Orientation::from_matrix([0; 9]), None);
    }
}
