//! What the motion of the camera can tell: whether the focal length may be free, and whether depth
//! needs a prior (the "uncertainty-aware" gate of docs/spec/front-end.md 1.6).
//!
//! With weights of 1, `h_d` is the median over pixels of all source frames of `sum_edges |Jz|^2`, and `h_f` is
//! `sum |Jf|^2 / (2 cx)^2` over everything. A camera that only turns has `h_d = 0` exactly.

use super::adjust::by_source;
use super::lanes::Rays;
use super::options::DbaOptions;
use super::problem::{DbaError, Factor, Geometry, Problem, project};
use super::source::Context;
use fearless_simd::Level;
use rayon::prelude::*;

/// Below this information the focal length stays as it is.
pub const FOCAL_GATE: f64 = 50.0;

/// Below this information depths keep their prior.
pub const DEPTH_GATE: f64 = 25.0;

/// Information about depth and focal length.
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

    /// Weight of the depth prior: `base exp(-0.1 h_d)` where there is little parallax, otherwise none. The
    /// published base is 1e-5.
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
    let parts: Vec<(Vec<f32>, f64)> = sources.par_iter().map(|s| s.information(&context)).collect();
    let focal = parts.iter().map(|p| p.1).sum::<f64>() / (4.0 * geometry.lens.cx * geometry.lens.cx);
    let mut depth: Vec<f32> = parts.into_iter().flat_map(|p| p.0).collect();
    Ok(Observability { depth: f64::from(lower_median(&mut depth)), focal })
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
            let p = project(&g, &geometry.lens, rate, u, v, geometry.disparity[edge.source][n]);
            if p.z > options.min_depth {
                sums[n] += p.by_disparity.norm_squared();
                focal += p.by_focal.norm_squared();
            }
        }
    }
    let mut depth: Vec<f64> = depth.into_iter().flatten().flatten().collect();
    Observability { depth: lower_median(&mut depth), focal: focal / (4.0 * geometry.lens.cx * geometry.lens.cx) }
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

#[cfg(test)]
mod tests {
    use super::{Observability, lower_median};

    #[test]
    fn the_lower_of_two_middle_values_counts() {
        assert_eq!(lower_median(&mut [4.0_f64, 1.0, 3.0, 2.0]), 2.0);
        assert_eq!(lower_median::<f64>(&mut []), 0.0);
    }

    #[test]
    fn a_turning_camera_keeps_its_prior_and_its_focal_length() {
        let turning = Observability { depth: 0.0, focal: 49.0 };
        assert_eq!((turning.focal_is_seen(), turning.prior_alpha(1e-5)), (false, Some(1e-5)));
        let walking = Observability { depth: 25.0, focal: 50.0 };
        assert_eq!((walking.focal_is_seen(), walking.prior_alpha(1e-5)), (true, None));
    }
}
