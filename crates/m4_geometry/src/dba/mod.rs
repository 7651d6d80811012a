//! Dense bundle adjustment: poses, one disparity a pixel and one focal length out of dense
//! correspondences.
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
//! **Conventions, which differ from those of the rest of the library.** Poses map world to camera.
//! The centre of pixel (0, 0) of the grid is at (0, 0). `G_ij = G_j G_i^-1` acts as `R X + d t` on
//! the homogeneous point `((u - cx)/fx, (v - cy)/fy, 1, d)`, `d` being the disparity (inverse
//! z-depth). Twists are translation first; a step is `exp(xi) G`. Residuals are
//! `target - projection`, weighted by `0.001 x confidence`. The conversion to the library's
//! conventions is [`Pinhole::of_image`] and the inverse of a pose.
//!
//! **Two implementations.** [`adjust()`] is the product's: f32 planes, sums of blocks in f32 and
//! everything above in f64, rayon over source frames. Its result does not depend on the number of
//! threads. [`adjust_reference`] is the oracle: f64, every block stored. Memory of the fast path is
//! a few rows of one block of pixels a thread, and the shares of 64 source frames; the coupling of
//! poses and disparities is never stored, but formed again for the back-substitution.

mod adjust;
mod lanes;
mod options;
mod problem;
mod reference;
mod source;
#[cfg(test)]
pub(crate) mod tests;

pub use adjust::adjust;
use adjust::by_source;
use fearless_simd::Level;
use lanes::Rays;
pub use options::{
    CURVATURE_FLOOR, DbaOptions, DbaReport, Free, MAX_DISPARITY, MIN_DISPARITY, SENSOR_KNOWN,
    WEIGHT_SCALE, depth_prior, stepped_disparity,
};
pub use problem::{
    DbaError, Factor, Geometry, Grid, MIN_DEPTH, PROJECTION_GUARD, Pinhole, Problem, Projected,
    project,
};
use rayon::prelude::*;
pub use reference::{EdgeSystem, adjust_reference, edge_system};
use source::Context;

/// Below this information the focal length stays as it is.
pub const FOCAL_GATE: f64 = 50.0;

/// Below this information depths keep their prior.
pub const DEPTH_GATE: f64 = 25.0;

/// What the motion of the camera can tell: whether the focal length may be free, and whether depth
/// needs a prior (the "uncertainty-aware" gate of docs/spec/front-end.md 1.6).
///
/// With weights of 1, `h_d` is the median over pixels of all source frames of `sum_edges |Jz|^2`,
/// and `h_f` is `sum |Jf|^2 / (2 cx)^2` over everything. A camera that only rotates has `h_d = 0`
/// exactly.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Observability {
    /// `h_d`, squared pixels of the grid by squared disparity.
    pub depth: f64,
    /// `h_f`, without unit.
    pub focal: f64,
}

impl Observability {
    /// Whether the focal length may move.
    #[must_use]
    pub fn focal_is_seen(&self) -> bool {
        self.focal >= FOCAL_GATE
    }

    /// Whether the clip shows depth by parallax.
    #[must_use]
    pub fn has_parallax(&self) -> bool {
        self.depth >= DEPTH_GATE
    }

    /// Weight of the depth prior: `base exp(-0.1 h_d)` where there is little parallax, otherwise
    /// none. The published base is 1e-5.
    #[must_use]
    pub fn prior_alpha(&self, base: f64) -> Option<f64> {
        (!self.has_parallax()).then(|| base * (-0.1 * self.depth).exp())
    }
}

/// Measures at the present geometry; weights, targets and damping of `problem` do not matter.
///
/// # Errors
///
/// [`DbaError`] where sizes or indices do not fit.
pub fn observability(
    geometry: &Geometry<f32>,
    problem: &Problem<'_, f32>,
    options: &DbaOptions,
) -> Result<Observability, DbaError> {
    problem.check(geometry, &(0..0))?;
    let context = Context {
        geometry,
        eta: problem.eta,
        rays: Rays::new(geometry.grid, &geometry.lens),
        options,
        level: Level::new(),
    };
    let sources = by_source(problem.edges, geometry.frames());
    let parts: Vec<(Vec<f32>, f64)> = sources
        .par_iter()
        .map(|s| s.information(&context))
        .collect();
    let focal =
        parts.iter().map(|p| p.1).sum::<f64>() / (4.0 * geometry.lens.cx * geometry.lens.cx);
    let mut depth: Vec<f32> = parts.into_iter().flat_map(|p| p.0).collect();
    Ok(Observability {
        depth: f64::from(lower_median(&mut depth)),
        focal,
    })
}

/// The same from the reference projection, in f64.
#[must_use]
pub fn observability_reference(
    geometry: &Geometry<f64>,
    edges: &[&Factor<f64>],
    options: &DbaOptions,
) -> Observability {
    let (width, len) = (geometry.grid.width, geometry.grid.len());
    let rate = options.fy_rate(&geometry.lens);
    let mut depth = vec![None; geometry.frames()];
    let mut focal = 0.0;
    for edge in edges {
        let g = geometry.relative(edge.source, edge.target);
        let sums = depth[edge.source].get_or_insert_with(|| vec![0.0; len]);
        for n in 0..len {
            let (u, v) = ((n % width) as f64, (n / width) as f64);
            let p = project(
                &g,
                &geometry.lens,
                rate,
                u,
                v,
                geometry.disparity[edge.source][n],
            );
            if p.z > options.min_depth {
                sums[n] += p.by_disparity.norm_squared();
                focal += p.by_focal.norm_squared();
            }
        }
    }
    let mut depth: Vec<f64> = depth.into_iter().flatten().flatten().collect();
    Observability {
        depth: lower_median(&mut depth),
        focal: focal / (4.0 * geometry.lens.cx * geometry.lens.cx),
    }
}

/// The middle value, of an even count the smaller of the two; 0 of nothing.
fn lower_median<T: m4_core::Real>(values: &mut [T]) -> T {
    if values.is_empty() {
        return T::zero();
    }
    let middle = (values.len() - 1) / 2;
    let order = |a: &T, b: &T| a.f64().total_cmp(&b.f64());
    *values.select_nth_unstable_by(middle, order).1
}
