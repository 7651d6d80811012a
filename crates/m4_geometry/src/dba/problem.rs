//! What is adjusted and what it is adjusted to; how a pixel with a disparity is seen in another
//! frame, and all derivatives of that: the reference.
//!
//! The homogeneous point of pixel `(u, v)` with disparity `d` is
//! `((u - cx)/fx, (v - cy)/fy, 1, d)`, and `G` acts on it as `R X + d t`, so the depth `1/d` is
//! never formed.

use m4_core::nalgebra::{Matrix2x6, Matrix6, Vector2, Vector3, Vector6};
use m4_core::{Real, Se3};
use serde::{Deserialize, Serialize};

/// The size of every plane: the images divided by eight.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Grid {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Grid {
    /// Number of pixels.
    #[must_use]
    pub fn len(&self) -> usize {
        self.width * self.height
    }

    /// True for a grid without pixels.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A lens without distortion, shared by all frames, in pixels of the grid; the centre of pixel (0,
/// 0) is at `(0, 0)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pinhole<T> {
    /// Focal length along x.
    pub fx: T,
    /// Focal length along y.
    pub fy: T,
    /// Column of the principal point.
    pub cx: T,
    /// Row of the principal point.
    pub cy: T,
}

impl Pinhole<f64> {
    /// The same lens on a grid of blocks of `block` x `block` pixels, `self` being of the full
    /// image with the principal point measured from the corner (the convention of the library).
    /// Grid coordinates divide the integer pixel coordinates of the image by `block`, as the
    /// tracker does.
    #[must_use]
    pub fn of_image(fx_px: f64, fy_px: f64, cx_px: f64, cy_px: f64, block: f64) -> Self {
        Self {
            fx: fx_px / block,
            fy: fy_px / block,
            cx: (cx_px - 0.5) / block,
            cy: (cy_px - 0.5) / block,
        }
    }

    /// With another scalar.
    #[must_use]
    pub fn cast<T: Real>(&self) -> Pinhole<T> {
        Pinhole {
            fx: T::of(self.fx),
            fy: T::of(self.fy),
            cx: T::of(self.cx),
            cy: T::of(self.cy),
        }
    }

    /// After a step `df` of the focal parameter, which is `fx / (2 cx)`; `fy` keeps its ratio to
    /// `fx`.
    #[must_use]
    pub fn with_focal_step(&self, df: f64) -> Self {
        let fx = self.fx + df * 2.0 * self.cx;
        Self {
            fx,
            fy: self.fy * fx / self.fx,
            ..*self
        }
    }
}

/// Poses, depth and lens: everything that bundle adjustment moves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Geometry<T: Real> {
    /// Size of every plane.
    pub grid: Grid,
    /// Shared by all frames.
    pub lens: Pinhole<f64>,
    /// World to camera, `[frames]`.
    pub poses: Vec<Se3<f64>>,
    /// Inverse z-depth, `[frames][height * width]`.
    pub disparity: Vec<Vec<T>>,
    /// Inverse z-depth from a sensor or a network, `[frames][height * width]`; 0 where unknown.
    pub sensor: Vec<Vec<T>>,
}

impl<T: Real> Geometry<T> {
    /// Number of frames.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.poses.len()
    }

    /// `G_ij = G_j G_i^-1`, from the camera of frame `i` to that of frame `j`.
    #[must_use]
    pub fn relative(&self, i: usize, j: usize) -> Se3<f64> {
        self.poses[j].compose(&self.poses[i].inverse())
    }
}

/// One directed edge of the graph: where the pixels of `source` are seen in `target`.
///
/// Planes are `[height * width]`, the u component first.
#[derive(Debug, Clone, PartialEq)]
pub struct Factor<T> {
    /// Frame whose pixels are followed.
    pub source: usize,
    /// Frame in which they are found.
    pub target: usize,
    /// Position in `target`, pixels of the grid.
    pub target_px: [Vec<T>; 2],
    /// Confidence of each component, 0 or more. Static confidence is already multiplied in.
    pub weight: [Vec<T>; 2],
}

/// Why a problem could not be posed: indices of frames that are not there, or planes of another
/// size.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct DbaError(String);

/// A state, the edges that pull at it and the damping of its disparities.
#[derive(Debug, Clone, Copy)]
pub struct Problem<'a, T> {
    /// The edges; several may join the same two frames.
    pub edges: &'a [&'a Factor<T>],
    /// Damping of disparities, `[frames][height * width]`.
    pub eta: &'a [Vec<T>],
}

impl<T: Real> Problem<'_, T> {
    /// Checks sizes and indices once, so that the kernels may index.
    ///
    /// # Errors
    ///
    /// [`DbaError`] for the first thing out of place.
    pub fn check(
        &self,
        geometry: &Geometry<T>,
        window: &std::ops::Range<usize>,
    ) -> Result<(), DbaError> {
        let (frames, expected) = (geometry.frames(), geometry.grid.len());
        if window.start > window.end || window.end > frames {
            return Err(DbaError(format!(
                "the window {window:?} of free poses does not lie within the {frames} frames"
            )));
        }
        let plane = |what: &str, index: usize, plane: Option<&Vec<T>>| {
            let count = plane.map_or(0, Vec::len);
            if count == expected {
                return Ok(());
            }
            Err(DbaError(format!(
                "{what} {index} has {count} values while the grid has {expected} pixels; give planes of [height * width]"
            )))
        };
        for i in 0..frames {
            plane("the disparity of frame", i, geometry.disparity.get(i))?;
            plane("the sensor disparity of frame", i, geometry.sensor.get(i))?;
            plane("the damping of frame", i, self.eta.get(i))?;
        }
        for (e, edge) in self.edges.iter().enumerate() {
            if edge.source >= frames || edge.target >= frames || edge.source == edge.target {
                return Err(DbaError(format!(
                    "edge {e} goes from frame {} to {} while there are {frames} frames; give edges between existing, different frames",
                    edge.source, edge.target
                )));
            }
            for k in 0..2 {
                plane("the target of edge", e, Some(&edge.target_px[k]))?;
                plane("the weight of edge", e, Some(&edge.weight[k]))?;
            }
        }
        Ok(())
    }
}

/// Below this scaled depth the projection divides by 1 instead; such a point is never valid.
pub const PROJECTION_GUARD: f64 = 0.1;

/// Least scaled depth `z` in the target of a valid point, as in the published solver for graphics
/// processors. Its Python twin has 0.2.
pub const MIN_DEPTH: f64 = 0.25;

/// One pixel as the target frame sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projected<T: Real> {
    /// Position, pixels of the grid.
    pub pixel: Vector2<T>,
    /// Depth in the target times the disparity in the source: 1 for a static camera.
    pub z: T,
    /// With respect to the left twist of the target's pose.
    pub by_target: Matrix2x6<T>,
    /// With respect to the left twist of the source's pose.
    pub by_source: Matrix2x6<T>,
    /// With respect to the disparity.
    pub by_disparity: Vector2<T>,
    /// With respect to the focal parameter `fx / (2 cx)`.
    pub by_focal: Vector2<T>,
}

/// Projects pixel `(u, v)` of disparity `d` by `g = G_ij`. `fy_rate` is the change of `fy` with
/// that of `fx`: their ratio where both follow one parameter.
pub fn project<T: Real>(
    g: &Se3<T>,
    lens: &Pinhole<T>,
    fy_rate: T,
    u: T,
    v: T,
    d: T,
) -> Projected<T> {
    let (one, zero) = (T::one(), T::zero());
    let ray = Vector3::new((u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy, one);
    let p = g.rotation * ray + g.translation * d;
    let (x, y, z) = (p.x, p.y, p.z);
    let iz = one / if z < T::of(PROJECTION_GUARD) { one } else { z };
    let (a, b) = (lens.fx * iz, lens.fy * iz);
    // Rows of the derivative of the pixel by the point.
    let (by_u, by_v) = (
        Vector3::new(a, zero, -a * x * iz),
        Vector3::new(zero, b, -b * y * iz),
    );
    let row = |j: &Vector3<T>| {
        let turn = p.cross(j);
        Vector6::new(d * j.x, d * j.y, d * j.z, turn.x, turn.y, turn.z).transpose()
    };
    let by_target = Matrix2x6::from_rows(&[row(&by_u), row(&by_v)]);
    // The ray bends as the focal length grows.
    let bend = g.rotation * Vector3::new(-ray.x / lens.fx, -ray.y * fy_rate / lens.fy, zero);
    let scale = T::of(2.0) * lens.cx;
    Projected {
        pixel: Vector2::new(a * x + lens.cx, b * y + lens.cy),
        z,
        by_target,
        by_source: -(by_target * g.adjoint()),
        by_disparity: Vector2::new(by_u.dot(&g.translation), by_v.dot(&g.translation)),
        by_focal: Vector2::new(x * iz + by_u.dot(&bend), fy_rate * y * iz + by_v.dot(&bend))
            * scale,
    }
}

/// `Ad(G_ij)^T` with the sign that turns what is known of the target into what is known of the
/// source: `H_ij = -M H_jj`, `v_i = -M v_j`, `E_i = -M E_j`.
pub(crate) fn source_from_target(g: &Se3<f64>) -> Matrix6<f64> {
    -g.adjoint().transpose()
}
