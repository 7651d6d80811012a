//! What the optimisation starts from.

use m4_core::{Intrinsics, Plane, Se3};

/// Poses, camera, disparity and certainty of a clip, all frames of one size.
#[derive(Debug, Clone, Copy)]
pub struct CvdInput<'a> {
    /// Camera to world, one per frame; held fixed.
    pub c2w: &'a [Se3<f64>],
    /// Of every frame, at the size of `disparity`.
    pub intrinsics: Intrinsics,
    /// One over z-depth, one plane per frame, in the unit of the poses; positive.
    pub disparity: &'a [Plane<f32>],
    /// u to start from, one plane per frame: [`uncertainty_of_static`] of the confidence that a pixel is static.
    pub uncertainty: &'a [Plane<f32>],
}

/// u to start from at a pixel that is static with confidence `m` in 0..1: `clamp(min(m, 0.5), 1e-3, 1)` (MegaSaM). What is not a
/// number counts as moving.
#[must_use]
pub fn uncertainty_of_static(m: f32) -> f32 {
    if m > 1e-3 { m.min(0.5) } else { 1e-3 }
}
