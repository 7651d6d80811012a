//! Which frames are compared with which.
//!
//! ```text
//! Geometry -> distance (how far pixels move between two frames)
//!          -> selection (candidate pairs, suppression around existing edges, greedy choice)
//!          -> FactorGraph (active, retired and rejected edges; ages; renumbering when a keyframe goes)
//! ```
//!
//! Source: docs/spec/front-end.md 1.5; DROID-SLAM (Teed and Deng 2021), section 3.1. Indices are those
//! of keyframes, poses map world to camera, positions are pixels of the grid (see [`crate::dba`]).
mod distance;
mod factor_graph;
mod selection;

pub use distance::{FAR, frame_distance, frame_distance_reference, symmetric_distances};
pub(crate) use factor_graph::projected_planes;
pub use factor_graph::{EdgeChanges, EdgeId, EdgeKey, FactorGraph, GraphEdge};
pub use selection::{ProximitySettings, neighbourhood, select_proximity};
