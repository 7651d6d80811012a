//! From frames to cameras, depth and a map of static regions.
//!
//! ```text
//! frames + sensor disparity
//!   -> Frontend   keyframes one by one, a window adjusted      (Correspondence revises the edges)
//!   -> Backend    probe of what can be seen, then all keyframes, focal length if it can be seen
//!   -> fill       frames between keyframes: interpolation, poses only
//!   -> Backend    all frames
//!   -> Tracked    poses, disparities, lens, static confidence
//! ```
//!
//! Source: docs/spec/front-end.md 1.5 and 1.6; MegaSaM (Li et al. 2025), section 3. What measures
//! correspondences is behind the trait [`Correspondence`]: a network revises its answer from where the present geometry
//! projects; optical flow would be computed once per pair. Poses inside map world to
//! camera and positions are pixels of the grid (see [`crate::dba`]); [`Tracked::c2w`] is the border.
//!
//! [`mono`] makes the sensor disparity out of two networks' depth.
pub mod mono;

mod backend;
mod correspondence;
mod filler;
mod frontend;
mod keyframes;
mod settings;
mod track;

pub use backend::{Backend, confidence_from_residuals};
pub use correspondence::{Correspondence, CorrespondenceError, EdgeRevision, Revision, SourceRevision, TrackerError};
pub use filler::{PUBLISHED_TIME_GUARD, fill, interpolate_pose, neighbours};
pub use frontend::{Frontend, Submitted};
pub use keyframes::{FrameInput, Keyframes};
pub use settings::TrackerSettings;
pub use track::{Clip, Tracked, track};

/// Share of the full motion in the distance of frames: 0.3.
const BETA: f64 = 0.3;
