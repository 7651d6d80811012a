//! Co-visibility: the pixels of a test image that the training frames saw. Scores elsewhere would measure invention, not reconstruction.
//!
//! ```text
//! test image, each training frame --flow, or depth and poses--> which pixels it saw --CovisibleCounts--> mask
//! ```
//!
//! DyCheck (Gao et al., NeurIPS 2022, section 3.2) counts, for each pixel of the test image, the training frames in which it is
//! not occluded by the forward-backward check of optical flow ([`seen_by_flow`]), and keeps those that more than
//! max(5, a tenth of the frames) saw. The masks that its authors publish (`covisible/2x/val`) were made so with RAFT; where they are
//! at hand they should be used, for figures to be comparable. [`seen_by_depth`] serves captures that have depth and poses instead: it
//! cannot follow the dynamic part, so that a moving thing counts as seen only by the frames in which it stands where it stood.

use super::{ImageError, same_size};
use m4_core::{Camera, DepthMap, Mask, Plane};

/// How many training frames are not enough: a covisible pixel was seen by more. As `process_covisible.py` of DyCheck has it, though
/// its paper and others write "at least".
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
        Self { counts: Plane::filled(width, height, 0), frames: 0 }
    }

    /// Adds a training frame, which saw the pixels of the test image that are not 0 in `seen`.
    ///
    /// # Errors
    ///
    /// [`ImageError::Size`] if `seen` has another size.
    pub fn add(&mut self, seen: &Mask) -> Result<(), ImageError> {
        same_size("the mask of what a training frame saw", self.counts.size(), seen.size())?;
        for (count, &seen) in self.counts.data_mut().iter_mut().zip(seen.data()) {
            *count += u32::from(seen != 0);
        }
        self.frames += 1;
        Ok(())
    }

    /// Training frames so far.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Number of frames that saw each pixel, `[height][width]`.
    #[must_use]
    pub fn counts(&self) -> &Plane<u32> {
        &self.counts
    }

    /// 255 where more than [`too_few_frames`] saw the pixel, else 0.
    #[must_use]
    pub fn mask(&self) -> Mask {
        let few = too_few_frames(self.frames);
        self.counts.map(|&n| if n as usize > few { 255 } else { 0 })
    }
}

/// By how much of itself a depth may differ and still be of the same surface: 5 %. Depth that was estimated agrees between frames to
/// some per cent; what hides something else is usually further in front of it.
pub const DEPTH_TOLERANCE: f64 = 0.05;

/// A frame with its depth.
#[derive(Debug, Clone, Copy)]
pub struct DepthView<'a> {
    /// Where it was taken, in the world of the other frames.
    pub camera: &'a Camera,
    /// z-depth in the units of that world, `[height][width]` of the camera's image; not above 0 or not finite where unknown.
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

/// 255 where a pixel of `test` is seen by `training`: its point lies in front of the training camera, lands in its image, and the depth of
/// the pixel there differs from the point's by at most `tolerance` times itself ([`DEPTH_TOLERANCE`] where there is no reason for another).
/// A point that is hidden there, one that floats before the surface there, and one whose depth is unknown on either side are not
/// seen.
///
/// # Errors
///
/// [`ImageError::Size`] if a depth map has another size than its camera's image.
pub fn seen_by_depth(test: DepthView<'_>, training: DepthView<'_>, tolerance: f64) -> Result<Mask, ImageError> {
    test.check("the depth of the test image")?;
    training.check("the depth of a training frame")?;
    let (width, height) = training.depth.size();
    let seen = |x: usize, y: usize| {
        let z = test.at(x, y)?;
        let world = test.camera.unproject(x as f64, y as f64, z);
        let ([u, v], z) = training.camera.project(&world);
        let (u, v) = (u.round(), v.round());
        let inside = z > 0.0 && u >= 0.0 && v >= 0.0 && u < width as f64 && v < height as f64;
        let there = inside.then(|| training.at(u as usize, v as usize))??;
        ((z - there).abs() <= tolerance * there).then_some(())
    };
    let (width, height) = test.depth.size();
    Ok(Plane::from_fn(width, height, |x, y| if seen(x, y).is_some() { 255 } else { 0 }))
}

/// 255 where a pixel of the test image is seen in a training frame: `|f + b|^2 <= 0.01 (|f|^2 + |b|^2) + 0.5` for the flow `f` from the
/// test image to the frame and the flow `b` back, read bilinearly where `f` leads (Brox et al., ECCV 2004; `compute_occ_brox` of
/// DyCheck, but exact where OpenCV rounds places to 1/32 px). Beyond the frame `b` is 0.
///
/// `forward` and `backward` are pixels to the right and down, `[height][width]`, of equal size. A pixel whose flow is not finite is not
/// seen.
///
/// # Errors
///
/// [`ImageError::Size`] if the sizes differ.
pub fn seen_by_flow(forward: &Plane<[f32; 2]>, backward: &Plane<[f32; 2]>) -> Result<Mask, ImageError> {
    same_size("the flow back", forward.size(), backward.size())?;
    let (width, height) = forward.size();
    let square = |[u, v]: [f64; 2]| u * u + v * v;
    Ok(Plane::from_fn(width, height, |x, y| {
        let f = forward[(x, y)].map(f64::from);
        let b = bilinear(backward, x as f64 + f[0], y as f64 + f[1]);
        let apart = square([f[0] + b[0], f[1] + b[1]]);
        // false for NaN
        if apart <= 0.01 * (square(f) + square(b)) + 0.5 { 255 } else { 0 }
    }))
}

/// The flow at a place (the centre of the first pixel: 0, 0), zeros beyond the border. NaN where the place is none.
fn bilinear(flow: &Plane<[f32; 2]>, x: f64, y: f64) -> [f64; 2] {
    if !(x.is_finite() && y.is_finite()) {
        return [f64::NAN; 2];
    }
    let (width, height) = flow.size();
    let at = |x: f64, y: f64| {
        let inside = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
        if inside { flow[(x as usize, y as usize)].map(f64::from) } else { [0.0; 2] }
    };
    let (x0, y0) = (x.floor(), y.floor());
    let (tx, ty) = (x - x0, y - y0);
    let mut out = [0.0; 2];
    for (dx, dy, weight) in [
        (0.0, 0.0, (1.0 - tx) * (1.0 - ty)),
        (1.0, 0.0, tx * (1.0 - ty)),
        (0.0, 1.0, (1.0 - tx) * ty),
        (1.0, 1.0, tx * ty),
    ] {
        // a neighbour without weight may lie beyond the border, or be no number
        if weight > 0.0 {
            let near = at(x0 + dx, y0 + dy);
            out = [out[0] + weight * near[0], out[1] + weight * near[1]];
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::{CovisibleCounts, DEPTH_TOLERANCE, DepthView, seen_by_depth, seen_by_flow, too_few_frames};
    use m4_core::nalgebra::Vector3;
    use m4_core::{Camera, Intrinsics, Plane, Se3};

    #[test]
    fn a_tenth_of_the_frames_but_five_are_too_few() {
        assert_eq!([0, 59, 60, 435].map(too_few_frames), [5, 5, 6, 43]);
        let mut counts = CovisibleCounts::new(4, 1);
        for i in 0..7 {
            let seen = Plane::from_fn(4, 1, |x, _| if i < [0, 5, 6, 7][x] { 1 } else { 0 });
            counts.add(&seen).unwrap();
        }
        assert_eq!(counts.frames(), 7);
        assert_eq!(counts.counts().data(), [0, 5, 6, 7]);
        assert_eq!(counts.mask().data(), [0, 0, 255, 255]);
        assert!(counts.add(&Plane::filled(1, 4, 1)).is_err());
    }

    fn camera(x: f64) -> Camera {
        Camera {
            intrinsics: Intrinsics::centred(20, 10, 10.0),
            c2w: Se3 { translation: Vector3::new(x, 0.0, 0.0), ..Se3::identity() },
        }
    }

    /// A wall at 4 with a box at 2 before it, seen from two places: what the box hides there is not seen.
    #[test]
    fn occluded_pixels_are_not_covisible() {
        let (here, there) = (camera(0.0), camera(1.0));
        // the box spans x from 0 to 1 in the world: columns 10..15 here, 5..10 there
        let of =
            |first: usize| Plane::from_fn(20, 10, move |x, _| if (first..first + 5).contains(&x) { 2.0 } else { 4.0 });
        let (a, b) = (of(10), of(5));
        let view = |camera, depth| DepthView { camera, depth };
        let seen = seen_by_depth(view(&here, &a), view(&there, &b), DEPTH_TOLERANCE).unwrap();
        for y in 0..10 {
            for x in 0..20 {
                // wall: moves by 2.5 columns; box: by 5
                let want = match x {
                    10..15 => true,
                    // beyond the left border, or behind the box there
                    _ => x >= 3 && !(8..13).contains(&x),
                };
                let edge = [2, 3, 7, 8, 12, 13].contains(&x);
                assert!(edge || (seen[(x, y)] == 255) == want, "{x}, {y}: {}", seen[(x, y)]);
            }
        }
        let count = seen.data().iter().filter(|&&m| m != 0).count();
        assert!((130..170).contains(&count), "{count}");
    }

    #[test]
    fn the_depth_tolerance_is_relative_and_unknown_depth_is_not_covisible() {
        let (here, there) = (camera(0.0), camera(0.0));
        let flat = |z: f32| Plane::filled(20, 10, z);
        let share = |a: f32, b: f32, tolerance| {
            let (a, b) = (flat(a), flat(b));
            let (test, training) = (DepthView { camera: &here, depth: &a }, DepthView { camera: &there, depth: &b });
            let seen = seen_by_depth(test, training, tolerance).unwrap();
            seen.data().iter().filter(|&&m| m != 0).count() as f64 / 200.0
        };
        assert_eq!((share(4.1, 4.0, 0.05), share(4.3, 4.0, 0.05), share(4.3, 4.0, 0.1)), (1.0, 0.0, 1.0));
        assert_eq!((share(3.9, 4.0, 0.05), share(3.7, 4.0, 0.05)), (1.0, 0.0));
        for bad in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert_eq!((share(bad, 4.0, 0.05), share(4.0, bad, 0.05)), (0.0, 0.0));
        }
        // behind the training camera
        let mut turned = there;
        turned.c2w.rotation[(0, 0)] = -1.0;
        turned.c2w.rotation[(2, 2)] = -1.0;
        let depth = flat(4.0);
        let view = |camera| DepthView { camera, depth: &depth };
        let seen = seen_by_depth(view(&here), view(&turned), 0.05).unwrap();
        assert!(seen.data().iter().all(|&m| m == 0));
        let small = Plane::filled(19, 10, 4.0);
        let small = DepthView { camera: &here, depth: &small };
        assert!(seen_by_depth(small, view(&there), 0.05).is_err());
    }

    #[test]
    fn forward_backward_consistent_pixels_are_visible() {
        // everything moves by (2, -1): two columns and a row leave
        let there = Plane::filled(8, 6, [2.0, -1.0]);
        let mut back = Plane::filled(8, 6, [-2.0, 1.0]);
        back[(5, 2)] = [f32::NAN, 0.0];
        let seen = seen_by_flow(&there, &back).unwrap();
        for y in 0..6 {
            for x in 0..8 {
                let want = x < 6 && y > 0 && (x, y) != (3, 3);
                assert_eq!(seen[(x, y)], if want { 255 } else { 0 }, "{x}, {y}");
            }
        }
        assert!(seen_by_flow(&there, &Plane::filled(8, 5, [0.0; 2])).is_err());
        let wild = Plane::filled(8, 6, [f32::INFINITY, 0.0]);
        assert!(seen_by_flow(&wild, &back).unwrap().data().iter().all(|&m| m == 0));
    }

    #[test]
    fn the_consistency_limit_grows_with_the_flow() {
        let at = |there: f32, back: f32| {
            let seen = seen_by_flow(&Plane::filled(40, 1, [there, 0.0]), &Plane::filled(40, 1, [back, 0.0])).unwrap();
            seen[(0, 0)] == 255
        };
        // 0.7^2 = 0.49, 0.72^2 = 0.52 of 0.5 + 0.01 * 0.52; 20 there and 18 back: 4 of 7.74 + 0.5; 17: 9 of 7.39
        assert!(at(0.0, 0.7) && !at(0.0, 0.72));
        assert!(at(20.0, -18.0) && !at(20.0, -17.0));
    }
}
