//! Initialisation: turns posed frames with depth and motion masks into the initial splats.
//!
//! [`initialise`] back-projects the depth of every frame, keeps static and dynamic points apart,
//! replaces the points of each voxel by their centroid and gives every centroid the size, opacity
//! and time span that the optimiser starts from (docs/spec/optimiser.md 2).
//!
//! ```text
//! cloud (depth -> points) -> free_space (what other frames see through goes) -> surface (one of what the frames agree on) -> voxel (points -> centroids) -> write (neighbours -> discs) -> rows
//!                                                        -> motion (keyframe to keyframe, windows of time) -> lives (how long a point follows it)
//! accuracy (motion against true tracks)
//! tracked (what tracks know of places that a keyframe cannot see)
//! change (moving shadows on static parts)    shell (something behind everything)
//! ```
//!
//! The result depends on the capture and the settings alone: points are merged by sorting 64-bit
//! voxel keys, never through a hash map, and no random number is drawn.

mod accuracy;
mod assemble;
mod change;
mod cloud;
mod config;
mod free_space;
mod lives;
mod motion;
mod rows;
mod shell;
mod surface;
mod tracked;
mod visible;
mod voxel;
mod write;

pub use accuracy::{CarriedErrors, LifeErrors, MotionErrors, motion_errors};
pub use assemble::{FirstSplats, initialise};
pub use config::{
    CellSize, InitConfig, InitError, LEAST_STATIC, TimeSpread, TrackedInit, VelocityInit,
};
