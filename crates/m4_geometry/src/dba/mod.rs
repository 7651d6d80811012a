//! Dense bundle adjustment: poses, one disparity a pixel and one focal length out of dense correspondences.
//!
//! ```text
//! Geometry (poses, disparities, lens) + Factor (where the pixels of i are seen in j, with weights)
//!   -> per edge: residuals and derivatives        lanes (fast)     reference (oracle)
//!   -> per source frame: disparities eliminated   source
//!   -> all poses (and the focal length)           adjust: damping, Cholesky in f64
//!   -> disparities substituted back               substitute
//! ```
//!
//! Source: docs/spec/front-end.md 1.6; DROID-SLAM (Teed and Deng 2021), section 3.3, and
//! MegaSaM (Li et al. 2025), section 3.2.
//!
//! **Conventions, which differ from those of the rest of the library.** Poses map world to camera. The centre of
//! pixel (0, 0) of the grid is at (0, 0). `G_ij = G_j G_i^-1` acts as `R X + d t` on the homogeneous point
//! `((u - cx)/fx, (v - cy)/fy, 1, d)`, `d` being the disparity (inverse z-depth). Twists are translation first;
//! a step is `exp(xi) G`. Residuals are `target - projection`, weighted by `0.001 x confidence`. The
//! conversion to the library's conventions is [`Pinhole::of_image`] and the inverse of a pose.
//!
//! **Two implementations.** [`adjust()`] is the product's: f32 planes, sums of blocks in f32 and everything above in
//! f64, rayon over source frames. Its result does not depend on the number of threads. [`adjust_reference`] is
//! the oracle: f64, every block stored. Memory of the fast path is a few rows of one block of pixels a
//! thread, and the shares of 64 source frames; the coupling of poses and disparities is never stored, but formed
//! again for the back-substitution.

mod adjust;
mod lanes;
mod observability;
mod options;
mod problem;
mod reference;
mod source;
mod substitute;
#[cfg(test)]
pub(crate) mod tests;

pub use adjust::adjust;
pub use observability::{DEPTH_GATE, FOCAL_GATE, Observability, observability, observability_reference};
pub use options::{
    CURVATURE_FLOOR, DbaOptions, DbaReport, Free, MAX_DISPARITY, MIN_DISPARITY, Robust, SENSOR_KNOWN, WEIGHT_SCALE,
    depth_prior, stepped_disparity,
};
pub use problem::{
    DbaError, Factor, Geometry, Grid, MIN_DEPTH, PROJECTION_GUARD, Pinhole, Problem, Projected, project,
};
pub use reference::{EdgeSystem, adjust_reference, edge_system};
