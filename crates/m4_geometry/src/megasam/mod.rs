//! MegaSaM's path from a video to cameras, depth and a map of static regions, with any source of correspondences, flow
//! and depth from one image.
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
//! Source: docs/spec/front-end.md 1; Li et al. 2025, "MegaSaM: Accurate, Fast, and Robust Structure and
//! Motion from Casual Dynamic Videos", section 3. Networks are behind [`crate::megasam::tracker::Correspondence`] and [`PairFlow`], so that the
//! same way can be gone with known flow.
//!
//! **Conventions.** The library's outside: camera to world, principal point from the corner of the image, z-depth.
//! A cell of the tracker's grid is the pixel at 8 times its column and row: there the features of a network that shrinks three
//! times by two are. The published program takes blocks of 8 x 8 pixels for depth and for the map of static regions
//! instead, half a block off.
//!
//! **Unit.** The tracker works on disparities whose 98th percentile is 2; what comes out is back in the unit of the depth.

pub mod cvd;
pub mod graph;
pub mod tracker;

mod flows;
mod prior;
mod reconstruct;
mod settings;
mod size;

pub use flows::{PairFlow, PairFlowError, SourceFlow};
pub use prior::{DepthPrior, PriorKind};
pub use reconstruct::{MegasamGeometry, MegasamInput, reconstruct, track};
pub use settings::{MegasamError, MegasamSettings, TAU_MOTION};
pub use size::TrackingSize;
