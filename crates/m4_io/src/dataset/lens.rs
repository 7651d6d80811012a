//! Camera models with distortion, and its removal from images, depth maps and masks.

use crate::{Fault, range};
use m4_core::{Intrinsics, Plane, RgbImage};

/// How a lens bends rays, from normalised pinhole coordinates `(x, y) = (X / Z, Y / Z)` to those
/// that the pixels have.
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
    /// OpenCV's fisheye: the angle `a` from the axis becomes
    /// `a (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8)`.
    Fisheye {
        /// `k1 k2 k3 k4`.
        k: [f64; 4],
    },
    /// The division model (Fitzgibbon 2001): the distance `d` from the axis in the image is that of
    /// a pinhole's point at `d / (1 + k d^2)`.
    Division {
        /// Below 0: barrel.
        k: f64,
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

    /// Where the ray through `(x, y)` of a pinhole arrives behind this lens, normalised
    /// coordinates.
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
            Self::Division { k } => {
                // The root ends at 0 where a pincushion shows no more.
                let root = (1.0 - 4.0 * k * (x * x + y * y)).max(0.0).sqrt();
                [x, y].map(|v| 2.0 * v / (1.0 + root))
            }
        }
    }

    /// Whether all coefficients are numbers.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        match self {
            Self::None => true,
            Self::Brown { radial, tangential } => {
                radial.iter().chain(tangential).all(|v| v.is_finite())
            }
            Self::Fisheye { k } => k.iter().all(|v| v.is_finite()),
            Self::Division { k } => k.is_finite(),
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

    /// Refuses sizes, focal lengths and principal points out of range, and coefficients that are no
    /// numbers.
    pub(crate) fn check(&self) -> Result<(), Fault> {
        let hint = "correct the camera in the source";
        if let Some(what) = range::of_lens(&self.intrinsics) {
            return Err(Fault::bad(what, hint));
        }
        if !self.distortion.is_finite() {
            return Err(Fault::bad(
                format!("a NaN or infinite coefficient: {:?}", self.distortion),
                hint,
            ));
        }
        Ok(())
    }

    /// Refuses an image of another size.
    pub(crate) fn check_size(&self, (width, height): (usize, usize)) -> Result<(), Fault> {
        let k = &self.intrinsics;
        if (k.width, k.height) == (width, height) {
            return Ok(());
        }
        let what = format!(
            "its image is {width} x {height} but its camera is of {} x {} pixels",
            k.width, k.height
        );
        Err(Fault::bad(
            what,
            "use the images that the cameras were computed from",
        ))
    }
}

/// Farthest that the focal length is stretched so that no pixel looks past the stored image.
const MAX_STRETCH: f64 = 8.0;
/// Samples along each side of the border.
const BORDER: usize = 64;

/// Where each pixel of an image through a pinhole lies in the stored one.
#[derive(Debug, Clone)]
pub struct Undistort {
    from: Lens,
    /// The pinhole that comes out: same size and principal point, the focal lengths stretched so
    /// that every pixel has a source.
    pub to: Intrinsics,
}

impl Undistort {
    /// Plans the removal of the distortion of `lens`; `None` for a pinhole.
    ///
    /// # Errors
    ///
    /// No pinhole can show the image: the distortion is not monotone.
    pub fn new(lens: &Lens) -> Result<Option<Self>, Fault> {
        if lens.distortion == Distortion::None {
            return Ok(None);
        }
        let stretched = |s: f64| Intrinsics {
            fx: lens.intrinsics.fx * s,
            fy: lens.intrinsics.fy * s,
            ..lens.intrinsics
        };
        let whole = |s: f64| {
            Self {
                from: *lens,
                to: stretched(s),
            }
            .covers()
        };
        let (mut low, mut high) = (0.25, MAX_STRETCH);
        if !whole(high) {
            let what = format!(
                "the distortion {:?} bends rays back within the image",
                lens.distortion
            );
            return Err(Fault::unsupported(
                what,
                "undistort the images with the tool that made them",
            ));
        }
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if whole(middle) {
                high = middle;
            } else {
                low = middle;
            }
        }
        Ok(Some(Self {
            from: *lens,
            to: stretched(high),
        }))
    }

    /// Pixel of the stored image, corner-based, that shows what is at corner-based `(u, v)` of the
    /// new one.
    fn source(&self, u: f64, v: f64) -> [f64; 2] {
        let (to, k) = (&self.to, &self.from.intrinsics);
        let [x, y] = self
            .from
            .distortion
            .distorted((u - to.cx) / to.fx, (v - to.cy) / to.fy);
        [k.fx * x + k.cx, k.fy * y + k.cy]
    }

    /// Whether the whole border, and rays towards it, come from within the stored image, in order.
    fn covers(&self) -> bool {
        let (w, h) = (self.to.width as f64, self.to.height as f64);
        let inside = |[u, v]: [f64; 2]| (0.0..=w).contains(&u) && (0.0..=h).contains(&v);
        let along = |i: usize| i as f64 / BORDER as f64;
        (0..=BORDER).all(|i| {
            let (u, v) = (along(i) * w, along(i) * h);
            [[u, 0.0], [u, h], [0.0, v], [w, v]]
                .into_iter()
                .all(|[u, v]| {
                    let mut last = 0.0;
                    inside(self.source(u, v))
                        && (1..=16).all(|k| {
                            let part = f64::from(k) / 16.0;
                            let [x, y] = [
                                (u - self.to.cx) / self.to.fx * part,
                                (v - self.to.cy) / self.to.fy * part,
                            ];
                            let [x, y] = self.from.distortion.distorted(x, y);
                            let r = x.hypot(y);
                            let grows = r >= last;
                            last = r;
                            grows
                        })
                })
        })
    }

    /// Shows an image of the stored size through the pinhole, bilinear.
    #[must_use]
    pub fn rgb(&self, image: &RgbImage) -> RgbImage {
        let (w, h) = image.size();
        Plane::from_fn(w, h, |x, y| {
            let [u, v] = self.source(x as f64 + 0.5, y as f64 + 0.5);
            let (u, v) = (
                (u - 0.5).clamp(0.0, (w - 1) as f64),
                (v - 0.5).clamp(0.0, (h - 1) as f64),
            );
            let (x0, y0) = (u.floor() as usize, v.floor() as usize);
            let (x1, y1) = ((x0 + 1).min(w - 1), (y0 + 1).min(h - 1));
            let (a, b) = (u - x0 as f64, v - y0 as f64);
            let at = |x: usize, y: usize, c: usize| f64::from(image[(x, y)][c]);
            std::array::from_fn(|c| {
                let top = at(x0, y0, c) * (1.0 - a) + at(x1, y0, c) * a;
                let low = at(x0, y1, c) * (1.0 - a) + at(x1, y1, c) * a;
                (top * (1.0 - b) + low * b).round() as u8
            })
        })
    }

    /// Shows a map or mask of any size through the pinhole, the nearest value.
    #[must_use]
    pub fn nearest<T: Copy>(&self, map: &Plane<T>) -> Plane<T> {
        let (w, h) = map.size();
        let (sx, sy) = (
            self.to.width as f64 / w as f64,
            self.to.height as f64 / h as f64,
        );
        let pixel = |u: f64, n: usize| (u.floor().max(0.0) as usize).min(n - 1);
        Plane::from_fn(w, h, |x, y| {
            let [u, v] = self.source((x as f64 + 0.5) * sx, (y as f64 + 0.5) * sy);
            map[(pixel(u / sx, w), pixel(v / sy, h))]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::Undistort;
    use crate::dataset::{Distortion, Lens};
    use m4_core::Intrinsics;

    fn lens(distortion: Distortion) -> Lens {
        Lens {
            intrinsics: Intrinsics::centred(120, 80, 100.0),
            distortion,
        }
    }

    #[test]
    fn pinholes_need_no_undistortion_and_folding_lenses_are_refused() {
        assert!(Undistort::new(&lens(Distortion::None)).unwrap().is_none());
        let folds = Undistort::new(&lens(Distortion::brown(-40.0, 0.0, 0.0, 0.0, 0.0)));
        assert!(folds.is_err() || folds.unwrap().unwrap().to.fx > 300.0);
    }
}
