//! Removes lens distortion from images, depth maps and masks.

use super::{Distortion, Lens};
use m4_core::{Intrinsics, Plane, RgbImage};

/// Farthest that the focal length is stretched so that no pixel looks past the stored image.
const MAX_STRETCH: f64 = 8.0;
/// Samples along each side of the border.
const BORDER: usize = 64;

/// Where each pixel of an image through a pinhole lies in the stored one.
#[derive(Debug, Clone)]
pub struct Undistort {
    from: Lens,
    /// The pinhole that comes out: same size and principal point, the focal lengths stretched so that every pixel has a source.
    pub to: Intrinsics,
}

impl Undistort {
    /// `None` for a lens without distortion.
    ///
    /// # Errors
    ///
    /// A lens whose image no pinhole can show: the distortion is not monotone within it.
    pub fn new(lens: &Lens) -> Result<Option<Self>, String> {
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
            return Err(format!(
                "the distortion {:?} bends rays back within the image",
                lens.distortion
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

    /// Pixel of the stored image, corner-based, that shows what is at corner-based `(u, v)` of the new one.
    fn source(&self, u: f64, v: f64) -> [f64; 2] {
        let (to, k) = (&self.to, &self.from.intrinsics);
        let [x, y] = self.from.distortion.distorted((u - to.cx) / to.fx, (v - to.cy) / to.fy);
        [k.fx * x + k.cx, k.fy * y + k.cy]
    }

    /// Whether the whole border, and rays towards it, come from within the stored image, in order.
    fn covers(&self) -> bool {
        let (w, h) = (self.to.width as f64, self.to.height as f64);
        let inside = |[u, v]: [f64; 2]| (0.0..=w).contains(&u) && (0.0..=h).contains(&v);
        let along = |i: usize| i as f64 / BORDER as f64;
        (0..=BORDER).all(|i| {
            let (u, v) = (along(i) * w, along(i) * h);
            [[u, 0.0], [u, h], [0.0, v], [w, v]].into_iter().all(|[u, v]| {
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

    /// An image of the stored size through the pinhole, bilinear.
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

    /// A map or mask of any size through the pinhole, the nearest value.
    #[must_use]
    pub fn nearest<T: Copy>(&self, map: &Plane<T>) -> Plane<T> {
        let (w, h) = map.size();
        let (sx, sy) = (self.to.width as f64 / w as f64, self.to.height as f64 / h as f64);
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
    use m4_core::{Intrinsics, Plane};

    fn lens(distortion: Distortion) -> Lens {
        Lens {
            intrinsics: Intrinsics::centred(120, 80, 100.0),
            distortion,
        }
    }

    #[test]
    fn undistortion_matches_pinhole_projection() {
        for distortion in [
            Distortion::brown(-0.25, 0.06, 0.0, 0.002, -0.003),
            Distortion::brown(0.6, 0.2, 0.0, 0.0, 0.0),
            Distortion::Fisheye {
                k: [0.05, -0.01, 0.002, 0.0],
            },
        ] {
            let lens = lens(distortion);
            let k = lens.intrinsics;
            // the world is a smooth pattern of the normalised pinhole coordinates, stored by solving for the ray of each pixel
            let colour = |x: f64, y: f64| {
                [
                    (127.0 + 100.0 * (3.0 * x).sin()) as u8,
                    (127.0 + 100.0 * (4.0 * y).cos()) as u8,
                    9,
                ]
            };
            let stored = Plane::from_fn(k.width, k.height, |px, py| {
                let (bx, by) = ((px as f64 + 0.5 - k.cx) / k.fx, (py as f64 + 0.5 - k.cy) / k.fy);
                let (mut x, mut y) = (bx, by);
                for _ in 0..100 {
                    let [dx, dy] = distortion.distorted(x, y);
                    (x, y) = (x + (bx - dx), y + (by - dy));
                }
                colour(x, y)
            });
            let map = Undistort::new(&lens).unwrap().unwrap();
            let out = map.rgb(&stored);
            let to = map.to;
            let mut worst = 0;
            for y in 0..k.height {
                for x in 0..k.width {
                    let want = colour((x as f64 + 0.5 - to.cx) / to.fx, (y as f64 + 0.5 - to.cy) / to.fy);
                    for c in 0..3 {
                        worst = worst.max(want[c].abs_diff(out[(x, y)][c]));
                    }
                }
            }
            assert!(worst <= 3, "{distortion:?}: {worst}");
            // without it the same image is off
            let moved = |i: usize| {
                let (x, y) = (i % k.width, i / k.width);
                let want = colour((x as f64 + 0.5 - to.cx) / to.fx, (y as f64 + 0.5 - to.cy) / to.fy);
                usize::from(want[0].abs_diff(stored.data()[i][0]) > 3)
            };
            let off: usize = (0..stored.data().len()).map(moved).sum();
            assert!(off > stored.data().len() / 50, "{distortion:?}: {off}");
        }
    }

    #[test]
    fn pinholes_need_no_undistortion_and_folding_lenses_are_refused() {
        assert!(Undistort::new(&lens(Distortion::None)).unwrap().is_none());
        let folds = Undistort::new(&lens(Distortion::brown(-40.0, 0.0, 0.0, 0.0, 0.0)));
        assert!(folds.is_err() || folds.unwrap().unwrap().to.fx > 300.0);
    }
}
