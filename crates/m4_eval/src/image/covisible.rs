//! Co-visibility: the pixels of a test image that the training frames saw. Scores elsewhere would
//! measure invention, not reconstruction.
//!
//! ```text
//! test image, each training frame --depth and poses--> which pixels it saw --CovisibleCounts--> mask
//! ```
//!
//! DyCheck (Gao et al., NeurIPS 2022, section 3.2) counts, for each pixel of the test image, the
//! training frames in which it is not occluded by the forward-backward check of optical flow, and
//! keeps those that more than max(5, a tenth of the frames) saw. The masks that its authors publish
//! (`covisible/2x/val`) were made so with RAFT; where they are at hand they should be used, for
//! figures to be comparable. [`seen_by_depth`] serves captures that have depth and poses instead:
//! it cannot follow the dynamic part, so that a dynamic object counts as seen only by the frames in
//! which it stands where it stood.

use super::{ImageError, same_size};
use m4_core::{Camera, DepthMap, Mask, Plane};

/// How many training frames are not enough: a covisible pixel was seen by more. As
/// `process_covisible.py` of DyCheck has it, though its paper and others write "at least".
#[must_use]
pub fn too_few_frames(training_frames: usize) -> usize {
    (training_frames / 10).max(5)
}

/// Number of training frames that saw each pixel of a test image.
#[derive(Debug, Clone, PartialEq)]
pub struct CovisibleCounts {
    counts: Plane<u32>,
    frames: usize,
}

impl CovisibleCounts {
    /// None yet, for an image of `width` by `height`.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            counts: Plane::filled(width, height, 0),
            frames: 0,
        }
    }

    /// Adds a training frame: it sees the pixels of the test image that are not 0 in `mask`.
    ///
    /// # Errors
    ///
    /// [`ImageError`] if `mask` has another size.
    pub fn add(&mut self, mask: &Mask) -> Result<(), ImageError> {
        same_size(
            "the mask of what a training frame saw",
            self.counts.size(),
            mask.size(),
        )?;
        for (count, &visible) in self.counts.data_mut().iter_mut().zip(mask.data()) {
            *count += u32::from(visible != 0);
        }
        self.frames += 1;
        Ok(())
    }

    /// 255 where more than [`too_few_frames`] saw the pixel, else 0.
    #[must_use]
    pub fn mask(&self) -> Mask {
        let few = too_few_frames(self.frames);
        self.counts.map(|&n| if n as usize > few { 255 } else { 0 })
    }
}

/// By how much of itself a depth may differ and still be of the same surface: 5 %. Depth that was
/// estimated agrees between frames to some per cent; what hides something else is usually further
/// in front of it.
pub const DEPTH_TOLERANCE: f64 = 0.05;

/// A frame with its depth.
#[derive(Debug, Clone, Copy)]
pub struct DepthView<'a> {
    /// Where it was taken, in the world of the other frames.
    pub camera: &'a Camera,
    /// z-depth in the units of that world, `[height][width]` of the camera's image; not above 0 or
    /// not finite where unknown.
    pub depth: &'a DepthMap,
}

impl DepthView<'_> {
    fn check(&self, what: &'static str) -> Result<(), ImageError> {
        let k = &self.camera.intrinsics;
        same_size(what, (k.width, k.height), self.depth.size())
    }

    fn at(&self, x: usize, y: usize) -> Option<f64> {
        let z = f64::from(self.depth[(x, y)]);
        (z.is_finite() && z > 0.0).then_some(z)
    }
}

/// 255 where a pixel of `test` is seen by `training`: its point lies in front of the training
/// camera, lands in its image, and the depth of the pixel there differs from the point's by at most
/// `tolerance` times itself ([`DEPTH_TOLERANCE`] where there is no reason for another). A point
/// that is hidden there, one that floats before the surface there, and one whose depth is unknown
/// on either side are not seen.
///
/// # Errors
///
/// [`ImageError`] if a depth map has another size than its camera's image.
pub fn seen_by_depth(
    test: DepthView<'_>,
    training: DepthView<'_>,
    tolerance: f64,
) -> Result<Mask, ImageError> {
    test.check("the depth of the test image")?;
    training.check("the depth of a training frame")?;
    let (width, height) = training.depth.size();
    let visible = |x: usize, y: usize| {
        let z = test.at(x, y)?;
        let world = test.camera.unproject(x as f64, y as f64, z);
        let ([u, v], z) = training.camera.project(&world);
        let (u, v) = (u.round(), v.round());
        let inside = z > 0.0 && u >= 0.0 && v >= 0.0 && u < width as f64 && v < height as f64;
        let training_depth = inside.then(|| training.at(u as usize, v as usize))??;
        ((z - training_depth).abs() <= tolerance * training_depth).then_some(())
    };
    let (width, height) = test.depth.size();
    Ok(Plane::from_fn(width, height, |x, y| {
        if visible(x, y).is_some() { 255 } else { 0 }
    }))
}

#[cfg(test)]
mod tests {
    use super::{CovisibleCounts, DEPTH_TOLERANCE, DepthView, seen_by_depth, too_few_frames};
    use m4_core::nalgebra::Vector3;
    use m4_core::{Camera, Intrinsics, Plane, Se3};

    #[test]
    fn a_tenth_of_the_frames_but_five_are_too_few() {
        assert_eq!([0, 59, 60, 435].map(too_few_frames), [5, 5, 6, 43]);
        let mut counts = CovisibleCounts::new(4, 1);
        for i in 0..7 {
            let mask = Plane::from_fn(4, 1, |x, _| if i < [0, 5, 6, 7][x] { 1 } else { 0 });
            counts.add(&mask).unwrap();
        }
        assert_eq!(counts.mask().data(), [0, 0, 255, 255]);
        assert!(counts.add(&Plane::filled(1, 4, 1)).is_err());
    }

    fn camera(x: f64) -> Camera {
        Camera {
            intrinsics: Intrinsics::centred(20, 10, 10.0),
            c2w: Se3 {
                translation: Vector3::new(x, 0.0, 0.0),
                ..Se3::identity()
            },
        }
    }

    /// A wall at 4 with a box at 2 before it, seen from two places: what the box hides there is not
    /// seen.
    #[test]
    fn occluded_pixels_are_not_covisible() {
        let (here, other) = (camera(0.0), camera(1.0));
        // the box spans x from 0 to 1 in the world: columns 10..15 here, 5..10 there
        let of = |first: usize| {
            Plane::from_fn(20, 10, move |x, _| {
                if (first..first + 5).contains(&x) {
                    2.0
                } else {
                    4.0
                }
            })
        };
        let (a, b) = (of(10), of(5));
        let view = |camera, depth| DepthView { camera, depth };
        let mask = seen_by_depth(view(&here, &a), view(&other, &b), DEPTH_TOLERANCE).unwrap();
        for y in 0..10 {
            for x in 0..20 {
                // wall: moves by 2.5 columns; box: by 5
                let want = match x {
                    10..15 => true,
                    // beyond the left border, or behind the box there
                    _ => x >= 3 && !(8..13).contains(&x),
                };
                let edge = [2, 3, 7, 8, 12, 13].contains(&x);
                assert!(
                    edge || (mask[(x, y)] == 255) == want,
                    "{x}, {y}: {}",
                    mask[(x, y)]
                );
            }
        }
        let count = mask.data().iter().filter(|&&m| m != 0).count();
        assert!((130..170).contains(&count), "{count}");
    }

    #[test]
    fn the_depth_tolerance_is_relative_and_unknown_depth_is_not_covisible() {
        let (first, other) = (camera(0.0), camera(0.0));
        let flat = |z: f32| Plane::filled(20, 10, z);
        let share = |a: f32, b: f32, tolerance| {
            let (a, b) = (flat(a), flat(b));
            let (test, training) = (
                DepthView {
                    camera: &first,
                    depth: &a,
                },
                DepthView {
                    camera: &other,
                    depth: &b,
                },
            );
            let mask = seen_by_depth(test, training, tolerance).unwrap();
            mask.data().iter().filter(|&&m| m != 0).count() as f64 / 200.0
        };
        assert_eq!(
            (
                share(4.1, 4.0, 0.05),
                share(4.3, 4.0, 0.05),
                share(4.3, 4.0, 0.1)
            ),
            (1.0, 0.0, 1.0)
        );
        assert_eq!((share(3.9, 4.0, 0.05), share(3.7, 4.0, 0.05)), (1.0, 0.0));
        for bad in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert_eq!((share(bad, 4.0, 0.05), share(4.0, bad, 0.05)), (0.0, 0.0));
        }
        // behind the training camera
        let mut opposite = other;
        opposite.c2w.rotation[(0, 0)] = -1.0;
        opposite.c2w.rotation[(2, 2)] = -1.0;
        let depth = flat(4.0);
        let view = |camera| DepthView {
            camera,
            depth: &depth,
        };
        let mask = seen_by_depth(view(&first), view(&opposite), 0.05).unwrap();
        assert!(mask.data().iter().all(|&m| m == 0));
        let small = Plane::filled(19, 10, 4.0);
        let small = DepthView {
            camera: &first,
            depth: &small,
        };
        assert!(seen_by_depth(small, view(&other), 0.05).is_err());
    }
}
