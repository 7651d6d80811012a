//! The distortion of a lens, by one coefficient: the division model (Fitzgibbon, 2001).
//!
//! A pinhole point at distance `u` from the image centre appears at distance `d` with
//! `u = d / (1 + k (d / r)^2)`; `r` is half of the image's diagonal, so that `k` has no unit.
//! Below 0: barrel, as of action cameras. The model stays monotone up to wide angles, where
//! polynomials of the angle's tangent bend back.

use m4_core::nalgebra::{Matrix2, Vector2};

/// Distortion of a lens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bend {
    /// `k`: 0 for a pinhole.
    pub coefficient: f64,
    /// `r`, pixels of the observations.
    pub radius_px: f64,
}

impl Bend {
    /// A pinhole.
    pub const NONE: Self = Self {
        coefficient: 0.0,
        radius_px: 1.0,
    };

    /// Where the lens shows a point of the pinhole image, pixels from the centre; `None` where it
    /// shows nothing.
    pub fn distorted(self, at: [f64; 2]) -> Option<[f64; 2]> {
        if self.coefficient == 0.0 {
            return Some(at);
        }
        let root = self.root(at);
        (root > 0.0).then(|| at.map(|v| 2.0 * v / (1.0 + root)))
    }

    /// The inverse of [`Self::distorted`].
    pub fn pinhole(self, at: [f64; 2]) -> [f64; 2] {
        // What no pinhole shows lies outside of the image for all coefficients that are tried.
        let down = (1.0 + self.coefficient * self.share(at)).max(0.02);
        at.map(|v| v / down)
    }

    /// Squared distance from the centre over that of the corners.
    fn share(self, at: [f64; 2]) -> f64 {
        (at[0] * at[0] + at[1] * at[1]) / (self.radius_px * self.radius_px)
    }

    fn root(self, at: [f64; 2]) -> f64 {
        let squared = 1.0 - 4.0 * self.coefficient * self.share(at);
        squared.max(0.0).sqrt()
    }

    /// Derivative of [`Self::distorted`] by `at`.
    pub fn by_position(self, at: [f64; 2]) -> Matrix2<f64> {
        let root = self.root(at).max(1e-9);
        let factor = 2.0 / (1.0 + root);
        let at = Vector2::from(at) / self.radius_px;
        let change = 2.0 * self.coefficient * factor * factor / root;
        Matrix2::identity() * factor + at * at.transpose() * change
    }

    /// Derivative of [`Self::distorted`] by the coefficient.
    pub fn by_coefficient(self, at: [f64; 2]) -> Vector2<f64> {
        let root = self.root(at).max(1e-9);
        let factor = 2.0 / (1.0 + root);
        Vector2::from(at) * (factor * factor * self.share(at) / root)
    }
}

#[cfg(test)]
mod tests {
    use super::Bend;

    #[test]
    fn distortion_and_its_inverse_agree_and_derivatives_match_differences() {
        for coefficient in [-0.4, -0.05, 0.0, 0.15] {
            let bend = Bend {
                coefficient,
                radius_px: 400.0,
            };
            let at = [170.0, -230.0];
            let shown = bend.distorted(at).expect("within the image");
            let back = bend.pinhole(shown);
            assert!((back[0] - at[0]).hypot(back[1] - at[1]) < 1e-9);
            let h = 1e-4;
            let by = bend.by_position(at);
            for k in 0..2 {
                let moved = |h: f64| {
                    let mut at = at;
                    at[k] += h;
                    bend.distorted(at).expect("within the image")
                };
                let (a, b) = (moved(h), moved(-h));
                for i in 0..2 {
                    assert!(((a[i] - b[i]) / (2.0 * h) - by[(i, k)]).abs() < 1e-6);
                }
            }
            let other = |h: f64| {
                let bend = Bend {
                    coefficient: coefficient + h,
                    ..bend
                };
                bend.distorted(at).expect("within the image")
            };
            let (a, b) = (other(1e-6), other(-1e-6));
            let by = bend.by_coefficient(at);
            for i in 0..2 {
                assert!(((a[i] - b[i]) / 2e-6 - by[i]).abs() < 1e-3);
            }
        }
    }
}
