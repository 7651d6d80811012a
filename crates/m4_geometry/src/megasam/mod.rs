//! MegaSaM's path from a video to cameras, depth and a map of static regions, with any source of
//! correspondences, flow and depth from one image.
//!
//! ```text
//! images --TrackingSize--> images of about 384 x 512 pixels
//! depth from one image --DepthPrior--> disparity of every frame, one scale for the clip
//!   -> track              cameras, focal length, static confidence at 1/8     (Correspondence: a network)
//!   -> flows              pairs 1, 2, 4, 8, 15 frames apart, both ways        (PairFlow: a network)
//!   -> reconstruct        depth at half the size that agrees along the flow
//!   -> MegasamGeometry    in metres where the depth was
//! ```
//!
//! Source: docs/spec/front-end.md 1; Li et al. 2025, "MegaSaM: Accurate, Fast, and Robust Structure
//! and Motion from Casual Dynamic Videos", section 3. Networks are behind
//! [`crate::megasam::tracker::Correspondence`] and [`PairFlow`], so that the same way can be gone
//! with known flow.
//!
//! **Conventions.** The library's outside: camera to world, principal point from the corner of the
//! image, z-depth. A cell of the tracker's grid is the pixel at 8 times its column and row: there
//! the features of a network that shrinks three times by two are. The published program takes
//! blocks of 8 x 8 pixels for depth and for the map of static regions instead, half a block off.
//!
//! **Unit.** The tracker works on disparities whose 98th percentile is 2; what comes out is back in
//! the unit of the depth.

pub mod cvd;
pub mod graph;
pub(crate) mod prior;
mod reconstruct;
pub mod tracker;

use crate::classical::dense::SourceError;
use crate::dba::{Grid, Pinhole};
use crate::resample::{bilinear, crop, resize_area};
use cvd::{CVD_STEPS, CvdError, PairError};
use m4_core::{Intrinsics, Plane, RgbImage};
pub use prior::{DepthPrior, PriorKind};
pub use reconstruct::{MegasamGeometry, MegasamInput, PairFlow, reconstruct, track};
use serde::{Deserialize, Serialize};
use tracker::{TrackerError, TrackerSettings};

/// Share of motion (1 - static confidence) above which a pixel counts as dynamic. 0.7: the paper's
/// tau.
pub const TAU_MOTION: f64 = 0.7;

/// Settings of [`reconstruct()`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MegasamSettings {
    /// Pixels of the images that are tracked. `384 * 512`: MegaSaM (docs/spec/front-end.md 1.1).
    /// The cost is proportional. For callers in Rust.
    #[serde(skip)]
    pub tracking_pixels: f64,
    /// Of the tracker. docs/spec/front-end.md 1.5. For callers in Rust.
    #[serde(skip)]
    pub tracker: TrackerSettings,
    /// Adam steps of both stages of consistent video depth. docs/spec/front-end.md 1.7. For callers
    /// in Rust.
    #[serde(skip)]
    pub cvd_steps: [usize; 2],
    /// Iterations of a recurrent network of flow. 22: MegaSaM.
    pub flow_iterations: usize,
    /// Megabytes of flow that stay in memory; the rest is on disk. 1,000: ours.
    pub flow_budget_mb: usize,
    /// Megabytes of the tracking network's features and states that stay in memory; the rest is on
    /// disk. 2,000: ours; a clip of 100 frames of 854 x 480 pixels has 1,500.
    pub memory_budget_mb: usize,
    /// Field of view where neither the user nor the depth knows one, degrees across. 60: ours, the
    /// main camera of common phones.
    pub default_fov_deg: f64,
}

impl Default for MegasamSettings {
    fn default() -> Self {
        Self {
            tracking_pixels: 384.0 * 512.0,
            tracker: TrackerSettings::default(),
            cvd_steps: CVD_STEPS,
            flow_iterations: 22,
            flow_budget_mb: 1000,
            memory_budget_mb: 2000,
            default_fov_deg: 60.0,
        }
    }
}

/// Why there is no geometry.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MegasamError {
    /// Images, instants or depth that do not fit together or are too small; the text says which.
    #[error("{0}")]
    Input(String),
    /// Cameras could not be found.
    #[error(transparent)]
    Tracker(#[from] TrackerError),
    /// Flow could not be had.
    #[error("there is no flow from frame {} to frame {}", between.0, between.1)]
    Flow {
        /// Where it would start, and where it would lead.
        between: (usize, usize),
        /// What went wrong.
        source: SourceError,
    },
    /// Flow could not be kept.
    #[error(transparent)]
    Pairs(#[from] PairError),
    /// Depth could not be made consistent.
    #[error(transparent)]
    Depth(#[from] CvdError),
    /// The user stopped.
    #[error("stopped by the user")]
    Cancelled,
}

impl MegasamError {
    /// True where the user stopped.
    #[must_use]
    pub fn is_stop(&self) -> bool {
        matches!(
            self,
            Self::Cancelled
                | Self::Tracker(TrackerError::Cancelled)
                | Self::Depth(CvdError::Cancelled { .. })
        )
    }
}

/// Pixels of a cell of the grid, a side.
const CELL_PX: usize = 8;

/// How images become smaller ones: to a fixed number of pixels, then cut to multiples of 8 at the
/// right and at the bottom (docs/spec/front-end.md 1.1). Sizes are `(width, height)`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct TrackingSize {
    /// Of the images.
    pub full: (usize, usize),
    /// After shrinking.
    pub scaled: (usize, usize),
    /// After cutting.
    pub cropped: (usize, usize),
}

impl TrackingSize {
    /// For images of a size and about `pixels` pixels at work: `384 * 512` in MegaSaM.
    ///
    /// # Errors
    ///
    /// [`MegasamError::Input`] if less than one cell a side would be left, or the numbers are no
    /// size.
    pub fn new(full: (usize, usize), pixels: f64) -> Result<Self, MegasamError> {
        let scale = (pixels / (full.0 as f64 * full.1 as f64)).sqrt();
        let scaled = (
            (full.0 as f64 * scale) as usize,
            (full.1 as f64 * scale) as usize,
        );
        let cropped = (scaled.0 / CELL_PX * CELL_PX, scaled.1 / CELL_PX * CELL_PX);
        if !(pixels.is_finite() && pixels <= 1e8) || cropped.0 == 0 || cropped.1 == 0 {
            return Err(MegasamError::Input(format!(
                "images of {}x{} pixels cannot be tracked at {pixels} pixels; fewer than 8 per side would be left, or the size is invalid",
                full.0, full.1
            )));
        }
        Ok(Self {
            full,
            scaled,
            cropped,
        })
    }

    /// The tracker's grid.
    #[must_use]
    pub fn grid(&self) -> Grid {
        Grid {
            width: self.cropped.0 / CELL_PX,
            height: self.cropped.1 / CELL_PX,
        }
    }

    /// An image at the size of tracking, by areas.
    #[must_use]
    pub fn resized(&self, full: &RgbImage) -> RgbImage {
        crop(
            &resize_area(full, self.scaled.0, self.scaled.1),
            self.cropped,
        )
    }

    /// A lens of the full images as one of the grid.
    #[must_use]
    pub fn grid_lens(&self, full: &Intrinsics) -> Pinhole<f64> {
        let k = full.resized(self.scaled.0, self.scaled.1);
        Pinhole::of_image(k.fx, k.fy, k.cx, k.cy, CELL_PX as f64)
    }

    /// The lens of the full images whose focal length on the grid is that of `grid`; the principal
    /// point is that of `full`.
    #[must_use]
    pub fn full_lens(&self, full: &Intrinsics, grid: &Pinhole<f64>) -> Intrinsics {
        let cell = CELL_PX as f64;
        Intrinsics {
            fx: grid.fx * cell * self.full.0 as f64 / self.scaled.0 as f64,
            fy: grid.fy * cell * self.full.1 as f64 / self.scaled.1 as f64,
            ..*full
        }
    }

    /// A lens of the full images as one of the cropped ones.
    #[must_use]
    pub fn cropped_lens(&self, full: &Intrinsics) -> Intrinsics {
        Intrinsics {
            width: self.cropped.0,
            height: self.cropped.1,
            ..full.resized(self.scaled.0, self.scaled.1)
        }
    }
}

/// A plane on the tracker's grid, whose cell `i` is pixel `8 i` of the images that are tracked, at
/// `width` x `height` pixels that cover `covered` pixels of those from the upper left corner;
/// constant beyond the outer cells.
fn from_grid(
    grid: &Plane<f32>,
    width: usize,
    height: usize,
    covered: (usize, usize),
) -> Plane<f32> {
    let (sx, sy) = (
        covered.0 as f32 / width as f32,
        covered.1 as f32 / height as f32,
    );
    // The middle of pixel i is (i + 0.5) scale from the corner.
    let cell = |i: usize, scale: f32| ((i as f32 + 0.5) * scale - 0.5) / CELL_PX as f32;
    Plane::from_fn(width, height, |x, y| {
        bilinear(grid, cell(x, sx), cell(y, sy))
    })
}

#[cfg(test)]
mod tests {
    use super::{TrackingSize, from_grid};
    use m4_core::{Intrinsics, Plane};

    #[test]
    fn a_common_size() {
        let size = TrackingSize::new((854, 480), 384.0 * 512.0).unwrap();
        assert_eq!((size.scaled, size.cropped), ((591, 332), (584, 328)));
        assert_eq!((size.grid().width, size.grid().height), (73, 41));
        assert!(TrackingSize::new((854, 480), 40.0).is_err());
        assert!(TrackingSize::new((0, 480), 4e5).is_err());
        assert!(TrackingSize::new((4, 4), f64::INFINITY).is_err());
    }

    #[test]
    fn grid_intrinsics_round_trip() {
        let size = TrackingSize::new((854, 480), 384.0 * 512.0).unwrap();
        let lens = Intrinsics::centred(854, 480, 700.0);
        let back = size.full_lens(&lens, &size.grid_lens(&lens));
        assert!((back.fx - 700.0).abs() < 1e-9 && (back.fy - 700.0).abs() < 1e-9);
        assert_eq!((back.cx, back.cy), (427.0, 240.0));
        // The image's middle, 295.5 from the corner, is column 295 of whole numbers.
        assert!((size.grid_lens(&lens).cx - 295.0 / 8.0).abs() < 1e-12);
    }

    #[test]
    fn a_grid_lies_on_every_eighth_pixel() {
        let grid = Plane::from_fn(5, 4, |x, y| (10 * x + 3 * y) as f32);
        let full = from_grid(&grid, 40, 32, (40, 32));
        assert_eq!((full.row(0)[0], full.row(16)[24]), (0.0, 36.0));
        assert!((full.row(0)[4] - 5.0).abs() < 1e-5);
        // Half the size: pixel 4 of it covers pixels 8 and 9, pixel 0 of it pixels 0 and 1.
        let half = from_grid(&grid, 20, 16, (40, 32));
        let want = (10.0 * 8.5 + 3.0 * 0.5) / 8.0;
        assert!((half.row(0)[4] - want).abs() < 1e-4, "{}", half.row(0)[4]);
    }
}
