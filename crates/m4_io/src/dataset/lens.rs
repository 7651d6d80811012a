//! Camera models with distortion.

use super::SourceErrorCause;
use m4_core::Intrinsics;

/// How a lens bends rays, from normalised pinhole coordinates `(x, y) = (X / Z, Y / Z)` to those that the pixels have.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Distortion {
    /// A pinhole.
    #[default]
    None,
    /// Brown's model as OpenCV's `OPENCV` and `FULL_OPENCV`.
    Brown {
        /// `k1 k2 k3` of the numerator, `k4 k5 k6` of the denominator.
        radial: [f64; 6],
        /// `p1 p2`.
        tangential: [f64; 2],
    },
    /// OpenCV's fisheye: the angle `a` from the axis becomes `a (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8)`.
    Fisheye {
        /// `k1 k2 k3 k4`.
        k: [f64; 4],
    },
}

impl Distortion {
    /// Brown's model with few coefficients; [`Distortion::None`] where all are 0.
    #[must_use]
    pub fn brown(k1: f64, k2: f64, k3: f64, p1: f64, p2: f64) -> Self {
        if [k1, k2, k3, p1, p2] == [0.0; 5] {
            return Self::None;
        }
        Self::Brown {
            radial: [k1, k2, k3, 0.0, 0.0, 0.0],
            tangential: [p1, p2],
        }
    }

    /// Where the ray through `(x, y)` of a pinhole arrives behind this lens, normalised coordinates.
    #[must_use]
    pub fn distorted(&self, x: f64, y: f64) -> [f64; 2] {
        match *self {
            Self::None => [x, y],
            Self::Brown { radial, tangential } => {
                let [k1, k2, k3, k4, k5, k6] = radial;
                let [p1, p2] = tangential;
                let r2 = x * x + y * y;
                let up = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                let down = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
                let s = up / down;
                [
                    x * s + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    y * s + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                ]
            }
            Self::Fisheye { k } => {
                let r = x.hypot(y);
                if r < 1e-12 {
                    return [x, y];
                }
                let a = r.atan();
                let a2 = a * a;
                let bent = a * (1.0 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3]))));
                [x * bent / r, y * bent / r]
            }
        }
    }

    /// Whether all coefficients are numbers.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        match self {
            Self::None => true,
            Self::Brown { radial, tangential } => radial.iter().chain(tangential).all(|v| v.is_finite()),
            Self::Fisheye { k } => k.iter().all(|v| v.is_finite()),
        }
    }
}

/// A lens as a file describes it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// The pinhole part, of the images as they are stored.
    pub intrinsics: Intrinsics,
    /// The rest.
    pub distortion: Distortion,
}

impl Lens {
    /// A lens without distortion.
    #[must_use]
    pub fn pinhole(intrinsics: Intrinsics) -> Self {
        Self {
            intrinsics,
            distortion: Distortion::None,
        }
    }

    /// What is wrong with its numbers.
    ///
    /// # Errors
    ///
    /// The value and what was expected.
    pub fn check(&self) -> Result<(), String> {
        let k = &self.intrinsics;
        let side = |n: usize| (1..=1 << 16).contains(&n);
        if !(side(k.width) && side(k.height)) {
            return Err(format!("images of {} x {} pixels", k.width, k.height));
        }
        if !(k.fx.is_finite() && k.fx > 0.0 && k.fy.is_finite() && k.fy > 0.0) {
            return Err(format!("focal lengths {} and {}, above 0 was expected", k.fx, k.fy));
        }
        if !(k.cx.is_finite() && k.cy.is_finite() && self.distortion.is_finite()) {
            return Err(format!("intrinsics with a NaN or infinite value: {self:?}"));
        }
        Ok(())
    }

    /// Refuses an image of another size.
    pub(crate) fn check_size(&self, (width, height): (usize, usize)) -> Result<(), SourceErrorCause> {
        let k = &self.intrinsics;
        if (k.width, k.height) == (width, height) {
            return Ok(());
        }
        let what = format!(
            "its image is {width} x {height} but its camera is of {} x {} pixels",
            k.width, k.height
        );
        Err(SourceErrorCause::bad(
            what,
            "use the images that the cameras were computed from",
        ))
    }
}
