//! What the optimisation starts from.

use m4_core::{Intrinsics, Plane, Se3};

/// Poses, camera, disparity and certainty of a clip, all frames of one size.
#[derive(Debug, Clone, Copy)]
pub struct CvdInput<'a> {
    /// Camera to world, one a frame; held fixed.
    pub c2w: &'a [Se3<f64>],
    /// Of every frame, at the size of `disparity`.
    pub intrinsics: Intrinsics,
    /// One over z-depth, one plane a frame, in the unit of the poses; positive.
    pub disparity: &'a [Plane<f32>],
    /// u to start from, one plane a frame: [`uncertainty_of_static`] of how sure it is that a pixel rests.
    pub uncertainty: &'a [Plane<f32>],
}

/// u to start from at a pixel that rests with confidence `m` in 0..1: `clamp(min(m, 0.5), 1e-3, 1)` (MegaSaM). What is not a
/// number counts as moving.
#[must_use]
pub fn uncertainty_of_static(m: f32) -> f32 {
    if m > 1e-3 { m.min(0.5) } else { 1e-3 }
}
