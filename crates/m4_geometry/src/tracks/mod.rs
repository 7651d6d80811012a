//! Points of dynamic parts followed through *all* frames of a posed clip, seen or hidden.
//!
//! ```text
//! masks every n-th frame -> grid of queries
//! CaptureClip (one frame at a time) -> strip (flow and depth of dynamic regions) -> chain -> lift -> fill -> again where it comes back
//! ```
//!
//! [`follow`] is the tracking enhancement of Minute4D without weights (section 3.2 of the paper;
//! docs/spec/front-end.md 3; docs/spec/front-end.md 7.1, item 8): it chains optical flow, lifts it
//! with depth, and where a point is hidden carries it on with the local rigid motion of its
//! neighbours (as rigid as possible: Sorkine and Alexa 2007), until it can be seen where it is
//! predicted. A network such as TAPIP3D takes the queries of the same grid ([`QueryGrid::queries`]:
//! frame and place in the world) and says where each is in every frame.
//!
//! Pixels here have the centre of the first one at (0, 0), as [`m4_core::Camera::project`] has
//! them; places are world units.

mod clip;
mod fill;
mod flow_tracker;
mod predict;
mod rigid;
mod tracker;

pub use clip::{CaptureClip, PosedFrame};
pub use flow_tracker::follow;
pub use tracker::{Query, QueryGrid, TrackError};

pub(crate) use clip::{Sparse, Strip, sparse_flow};
pub(crate) use fill::{Board, TrackInputs, fill};
pub(crate) use flow_tracker::{board_of, followed, on_grid};
pub(crate) use tracker::seed;
