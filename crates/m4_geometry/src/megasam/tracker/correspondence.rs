//! The seam between geometry and whatever measures where pixels go, and why tracking ended early.

use crate::dba::{DbaError, Grid};
use crate::megasam::graph::{EdgeChanges, EdgeKey};
use std::ops::Range;

/// Why correspondences could not be had.
#[derive(Debug, thiserror::Error)]
#[error("correspondences failed: {0}")]
pub struct CorrespondenceError(#[source] pub Box<dyn std::error::Error + Send + Sync>);

/// One edge to revise. Planes are `[height * width]`, positions are pixels of the grid.
#[derive(Debug)]
pub struct EdgeRevision<'a> {
    /// Which edge, and which frames of the clip it joins.
    pub key: EdgeKey,
    /// Where the present geometry sees the pixels of the source in the target; u, then v.
    pub projected_px: [Vec<f32>; 2],
    /// On entry the previous answer (for a new edge the projection when it was added), on return
    /// the measured position.
    pub target_px: &'a mut [Vec<f32>; 2],
    /// To be written: confidence of each component, 0 or more (a network's are in 0..=1).
    pub weight: &'a mut [Vec<f32>; 2],
    /// Output: the probability that the pixel is static, 0..=1. Multiplied into the weight by the
    /// caller.
    pub static_confidence: &'a mut Vec<f32>,
}

/// One source frame of the edges of a revision.
#[derive(Debug)]
pub struct SourceRevision<'a> {
    /// Number of the frame in the clip.
    pub frame: usize,
    /// Its edges in [`Revision::edges`].
    pub edges: Range<usize>,
    /// To be written: damping `eta` of the disparities, `[height * width]`, at least 0; a network's
    /// is `0.01 softplus`, so about 0.005.
    pub damping: &'a mut Vec<f32>,
}

/// What is asked of a source of correspondences.
#[derive(Debug)]
pub struct Revision<'a> {
    /// Size of all planes.
    pub grid: Grid,
    /// Edges, those of one source frame together.
    pub edges: Vec<EdgeRevision<'a>>,
    /// The source frames, ascending by keyframe. All edges of a frame that are revised in this step
    /// are in the same request, so a source may aggregate over them.
    pub sources: Vec<SourceRevision<'a>>,
}

/// Where the pixels of one frame are seen in another: precomputed flow, a recurrent network, an
/// oracle.
///
/// Frames are numbers in the clip and do not change when keyframes are renumbered; edges are named
/// by [`EdgeKey::id`], so that a network can keep a hidden state for each.
pub trait Correspondence {
    /// Edges that became active and edges that will not be asked for again. Called before
    /// [`revise`](Self::revise) sees an edge for the first time.
    ///
    /// # Errors
    ///
    /// [`CorrespondenceError`] when what an edge needs cannot be made.
    fn change(&mut self, changes: &EdgeChanges) -> Result<(), CorrespondenceError>;

    /// Revises targets, weights, static confidence and damping, from where the present geometry
    /// projects pixels.
    ///
    /// # Errors
    ///
    /// [`CorrespondenceError`] when an edge cannot be measured.
    fn revise(&mut self, revision: &mut Revision<'_>) -> Result<(), CorrespondenceError>;

    /// Mean motion of the pixels from one frame of the clip to another, pixels of the grid: decides
    /// which frames are looked at closely.
    ///
    /// # Errors
    ///
    /// [`CorrespondenceError`] when the two frames cannot be compared.
    fn motion_px(&mut self, from_frame: usize, to_frame: usize)
    -> Result<f64, CorrespondenceError>;
}

/// A clip has at least two frames.
pub(super) fn check_count(count: usize) -> Result<(), TrackerError> {
    if count >= 2 {
        return Ok(());
    }
    Err(TrackerError::Input(format!(
        "the clip has {count} frame(s); at least 2 are needed to observe motion"
    )))
}

/// Why a clip could not be tracked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrackerError {
    /// The source of correspondences gave up.
    #[error(transparent)]
    Correspondence(#[from] CorrespondenceError),
    /// Planes or indices that do not fit.
    #[error(transparent)]
    Dba(#[from] DbaError),
    /// Frames or depth that cannot be tracked; the text says why.
    #[error("{0}")]
    Input(String),
    /// The state became useless.
    #[error(
        "the adjustment of {keyframes} keyframes gave a NaN or infinite value; check the correspondences (or supply \
         a capture with poses)"
    )]
    Diverged {
        /// Keyframes at that time.
        keyframes: usize,
    },
    /// The user stopped the run.
    #[error("stopped by the user")]
    Cancelled,
}
