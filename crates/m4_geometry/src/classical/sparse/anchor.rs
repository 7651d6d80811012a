//! The first appearance of a point, aligned to later frames by an affine warp (Shi and Tomasi 1994;
//! inverse compositional form of Baker and Matthews 2004).
//!
//! Positions measured from frame to frame drift: their errors add up. Those aligned to one patch do
//! not, as long as the warp follows what the change of the view does to the patch.

use super::klt::{centre, dot};
use m4_core::Plane;
use m4_core::nalgebra::{Matrix2, Matrix6, Vector2, Vector6};

/// Reach of the patch, working pixels: 7 for a side of 15. An affine warp of 11 pixels is not
/// determined well enough (docs/decisions/0010).
const REACH: usize = 7;
const SIDE: usize = 2 * REACH + 1;
const AREA: usize = SIDE * SIDE;
/// Gauss-Newton steps.
const ITERATIONS: usize = 12;
/// A step that moves no pixel of the patch by more than this is the last one, pixels.
const SMALL_PX: f32 = 0.003;
/// Weight of the change of the linear part since the frame before, in squared grey levels: pixels
/// are off by 2 grey levels (compression, interpolation), and 0.01 a frame is a usual change. It
/// holds what the patch does not show. A quarter of it and five times as much gave like cameras,
/// which covers other rates of frames: the change of a frame is smaller at a higher rate.
const STEADINESS: f32 = 4e4;

/// Where a patch lies in another image: `x -> linear x + at` for `x` from the patch's centre,
/// pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Warp {
    pub linear: Matrix2<f32>,
    pub at: [f32; 2],
}

/// A square patch with its mean taken out, and what a step of alignment needs of it.
#[derive(Debug, Clone)]
pub(crate) struct Anchor {
    /// Values less their mean.
    values: Box<[f32; AREA]>,
    /// Derivatives by translation and by the linear part (row by row), less their means.
    jacobian: Box<[[f32; AREA]; 6]>,
    inverse: Matrix6<f32>,
    /// Root of the sum of squared `values`.
    norm: f32,
}

impl Anchor {
    /// The patch around `p` in an image at [`doubled`](super::luma::doubled) resolution; `None`
    /// when it shows nothing to hold on to.
    pub fn new(fine: &Plane<f32>, p: [f32; 2]) -> Option<Self> {
        const WIDE: usize = SIDE + 2;
        let mut patch = [0.0; WIDE * WIDE];
        sample::<WIDE>(
            fine,
            &Warp {
                linear: Matrix2::identity(),
                at: p,
            },
            &mut patch,
        );
        let mut values = Box::new([0.0; AREA]);
        let mut jacobian = Box::new([[0.0; AREA]; 6]);
        for y in 0..SIDE {
            for x in 0..SIDE {
                let (i, k) = ((y + 1) * WIDE + x + 1, y * SIDE + x);
                let [gx, gy] = [
                    0.5 * (patch[i + 1] - patch[i - 1]),
                    0.5 * (patch[i + WIDE] - patch[i - WIDE]),
                ];
                let (dx, dy) = (x as f32 - REACH as f32, y as f32 - REACH as f32);
                values[k] = patch[i];
                for (column, value) in
                    jacobian
                        .iter_mut()
                        .zip([gx, gy, gx * dx, gx * dy, gy * dx, gy * dy])
                {
                    column[k] = value;
                }
            }
        }
        let norm = centre(&mut values[..]);
        for column in jacobian.iter_mut() {
            centre(column);
        }
        let mut h = Matrix6::from_fn(|i, j| dot(&jacobian[i], &jacobian[j]));
        for k in 2..6 {
            h[(k, k)] += STEADINESS;
        }
        let inverse = h.try_inverse()?;
        Some(Self {
            values,
            jacobian,
            inverse,
            norm,
        })
    }

    /// Moves `start`, the warp to the frame before at the place to begin with, until the patch in
    /// `fine`, an image at doubled resolution, looks like this one; the warp and the normalised
    /// cross-correlation there.
    pub fn align(&self, fine: &Plane<f32>, start: Warp) -> (Warp, f32) {
        let mut patch = [0.0; AREA];
        let mut warp = start;
        let back = start.linear.try_inverse().unwrap_or_else(Matrix2::identity);
        for _ in 0..ITERATIONS {
            sample::<SIDE>(fine, &warp, &mut patch);
            for (value, want) in patch.iter_mut().zip(&*self.values) {
                *value -= want;
            }
            let changed = back * warp.linear - Matrix2::identity();
            let held = Vector6::new(0.0, 0.0, changed.m11, changed.m12, changed.m21, changed.m22)
                * STEADINESS;
            let d = self.inverse * (Vector6::from_fn(|i, _| dot(&self.jacobian[i], &patch)) + held);
            let Some(undo) = Matrix2::new(1.0 + d[2], d[3], d[4], 1.0 + d[5]).try_inverse() else {
                break;
            };
            warp.linear *= undo;
            let moved = warp.linear * Vector2::new(d[0], d[1]);
            warp.at = [warp.at[0] - moved.x, warp.at[1] - moved.y];
            let reach = REACH as f32;
            let furthest = d[0].abs().max(d[1].abs()) + reach * d.rows(2, 4).amax();
            // A patch cannot see further than itself.
            if furthest.is_nan() || furthest > reach || furthest < SMALL_PX {
                break;
            }
        }
        sample::<SIDE>(fine, &warp, &mut patch);
        let norm = centre(&mut patch);
        let product = dot(&patch, &*self.values);
        (
            warp,
            if norm * self.norm > 0.0 {
                product / (norm * self.norm)
            } else {
                0.0
            },
        )
    }
}

/// The patch of side `N` that `warp` marks in an image at doubled resolution, bilinear; outside the
/// image the nearest pixel counts.
fn sample<const N: usize>(fine: &Plane<f32>, warp: &Warp, out: &mut [f32]) {
    let (w, h) = fine.size();
    let (right, bottom) = ((w - 1) as f32, (h - 1) as f32);
    let data = fine.data();
    let (linear, at, reach) = (warp.linear * 2.0, warp.at.map(|v| 2.0 * v), (N / 2) as f32);
    for (r, line) in out.chunks_exact_mut(N).enumerate() {
        let dy = r as f32 - reach;
        let from = [at[0] + linear.m12 * dy, at[1] + linear.m22 * dy];
        for (c, value) in line.iter_mut().enumerate() {
            let dx = c as f32 - reach;
            let x = (from[0] + linear.m11 * dx).clamp(0.0, right);
            let y = (from[1] + linear.m21 * dx).clamp(0.0, bottom);
            let (ix, iy) = ((x as usize).min(w - 2), (y as usize).min(h - 2));
            let (ax, ay) = (x - ix as f32, y - iy as f32);
            let i = iy * w + ix;
            let top = data[i] + ax * (data[i + 1] - data[i]);
            let under = data[i + w] + ax * (data[i + w + 1] - data[i + w]);
            *value = top + ay * (under - top);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Anchor, Warp};
    use crate::classical::sparse::luma::doubled;
    use m4_core::Plane;
    use m4_core::nalgebra::{Matrix2, Vector2};

    /// Smooth bumps, seen through `x -> linear (x - centre) + at`, at doubled resolution.
    fn view_through(warp: &Warp) -> Plane<f32> {
        let back = warp.linear.try_inverse().expect("invertible");
        doubled(&Plane::from_fn(96, 72, |x, y| {
            let p = back * Vector2::new(x as f32 - warp.at[0], y as f32 - warp.at[1]);
            let (u, v) = (p.x + CENTRE[0], p.y + CENTRE[1]);
            120.0
                + 50.0 * (0.6 * u).sin() * (0.5 * v + 0.2 * u).cos()
                + 40.0 * (0.25 * u - 0.4 * v).cos()
        }))
    }

    const CENTRE: [f32; 2] = [48.0, 36.0];

    #[test]
    fn a_patch_is_followed_through_scaling_stretching_and_rotation() {
        let first = Warp {
            linear: Matrix2::identity(),
            at: CENTRE,
        };
        let anchor = Anchor::new(&view_through(&first), CENTRE).expect("texture");
        // A quarter larger and turned by 14 degrees at the end, with unequal sides.
        let mut warp = first;
        for step in 1..=20 {
            let t = step as f32;
            let truth = Warp {
                linear: Matrix2::new(1.0 + 0.01 * t, -0.015 * t, 0.015 * t, 1.0 + 0.008 * t),
                at: [CENTRE[0] + 0.4 * t, CENTRE[1] - 0.3 * t],
            };
            let (estimate, likeness) = anchor.align(
                &view_through(&truth),
                Warp {
                    at: [warp.at[0] + 0.6, warp.at[1] - 0.1],
                    ..warp
                },
            );
            let off = (estimate.at[0] - truth.at[0]).hypot(estimate.at[1] - truth.at[1]);
            assert!(
                off < 0.04 && likeness > 0.99,
                "step {step}: {off} px, {likeness}"
            );
            assert!(
                (estimate.linear - truth.linear).amax() < 0.02,
                "{estimate:?} {truth:?}"
            );
            warp = estimate;
        }
    }

    /// Texture at the limit of what pixels show: between whole pixels bilinear values are blurred,
    /// which moves the patch.
    #[test]
    fn fractions_of_a_pixel_are_not_pulled_to_whole_ones() {
        let fine = |shift: f32| {
            let wave = |x: f32, y: f32| {
                (1.1 * x + 0.4 * y).sin() + (0.5 * x - 1.2 * y).cos() + (0.3 * x + 0.2 * y).sin()
            };
            doubled(&Plane::from_fn(96, 72, |x, y| {
                128.0 + 30.0 * wave(x as f32 - shift, y as f32 + 0.5 * shift)
            }))
        };
        let first = Warp {
            linear: Matrix2::identity(),
            at: CENTRE,
        };
        let anchor = Anchor::new(&fine(0.0), CENTRE).expect("texture");
        for shift in [0.1, 0.25, 0.4, 0.6, 0.8] {
            let (estimate, _) = anchor.align(&fine(shift), first);
            let off = (estimate.at[0] - CENTRE[0] - shift)
                .hypot(estimate.at[1] - CENTRE[1] + 0.5 * shift);
            assert!(off < 0.01, "shift {shift}: {off} px");
        }
    }

    #[test]
    fn other_content_does_not_look_alike_and_flat_patches_are_refused() {
        let first = Warp {
            linear: Matrix2::identity(),
            at: CENTRE,
        };
        let anchor = Anchor::new(&view_through(&first), CENTRE).expect("texture");
        let other = Plane::from_fn(96, 72, |x, y| ((x * 7919 + y * 104_729) % 251) as f32);
        assert!(anchor.align(&doubled(&other), first).1 < 0.7);
        let (_, likeness) = anchor.align(&doubled(&Plane::filled(96, 72, 90.0)), first);
        assert_eq!(likeness, 0.0);
        assert!(Anchor::new(&doubled(&Plane::filled(96, 72, 90.0)), CENTRE).is_none());
    }
}
