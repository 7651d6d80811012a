//! What is adjusted and what it is adjusted to.

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

/// A lens without distortion, shared by all frames, in pixels of the grid; the centre of pixel (0, 0) is at
/// `(0, 0)`.
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
    /// The same lens on a grid of blocks of `block` x `block` pixels, `self` being of the full image with the
    /// principal point measured from the corner (the convention of the library). Grid coordinates divide
    /// the integer pixel coordinates of the image by `block`, as the tracker does.
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

    /// After a step `df` of the focal parameter, which is `fx / (2 cx)`; `fy` keeps its ratio to `fx`.
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

/// Why a problem could not be posed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DbaError {
    /// An edge names a frame that is not there.
    #[error(
        "edge {edge} goes from frame {source_frame} to {target_frame} while there are {frames} frames; give edges between existing, different frames"
    )]
    NoSuchFrame {
        /// Index of the edge.
        edge: usize,
        /// Its source.
        source_frame: usize,
        /// Its target.
        target_frame: usize,
        /// Frames there are.
        frames: usize,
    },
    /// A plane of the wrong size.
    #[error("{what} {index} has {found} values while the grid has {expected} pixels; give planes of [height * width]")]
    PlaneSize {
        /// Which plane.
        what: &'static str,
        /// Index of the frame or edge.
        index: usize,
        /// Its length.
        found: usize,
        /// Pixels of the grid.
        expected: usize,
    },
    /// A pose window that reaches beyond the frames.
    #[error("the window {start}..{end} of free poses does not lie within the {frames} frames")]
    Window {
        /// First free pose.
        start: usize,
        /// One beyond the last.
        end: usize,
        /// Frames there are.
        frames: usize,
    },
}

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
    pub fn check(&self, geometry: &Geometry<T>, window: &std::ops::Range<usize>) -> Result<(), DbaError> {
        let (frames, expected) = (geometry.frames(), geometry.grid.len());
        if window.start > window.end || window.end > frames {
            return Err(DbaError::Window {
                start: window.start,
                end: window.end,
                frames,
            });
        }
        let plane = |what, index, plane: Option<&Vec<T>>| {
            let found = plane.map_or(0, Vec::len);
            if found == expected {
                Ok(())
            } else {
                Err(DbaError::PlaneSize {
                    what,
                    index,
                    found,
                    expected,
                })
            }
        };
        for i in 0..frames {
            plane("the disparity of frame", i, geometry.disparity.get(i))?;
            plane("the sensor disparity of frame", i, geometry.sensor.get(i))?;
            plane("the damping of frame", i, self.eta.get(i))?;
        }
        for (e, edge) in self.edges.iter().enumerate() {
            if edge.source >= frames || edge.target >= frames || edge.source == edge.target {
                return Err(DbaError::NoSuchFrame {
                    edge: e,
                    source_frame: edge.source,
                    target_frame: edge.target,
                    frames,
                });
            }
            for k in 0..2 {
                plane("the target of edge", e, Some(&edge.target_px[k]))?;
                plane("the weight of edge", e, Some(&edge.weight[k]))?;
            }
        }
        Ok(())
    }
}
