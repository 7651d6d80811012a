//! Reads camera paths for rendering.
//!
//! Two layouts of JSON are read, distinguished by their keys: `transforms.json` (one camera per image: `frames[]` with
//! `transform_matrix`, `time`, `fl_x` .. `h`; see [`crate::dataset::nerfstudio`]), and keyframes between which the caller
//! interpolates ([`Keyed`], described in docs/paths.md).

mod error;
mod file;
mod keyed;
mod listed;
mod own;

pub use error::ReadTrajectoryError;
pub use file::{Trajectory, load, read};
pub use keyed::{KeyPose, Keyed, Keyframe, SceneTime};
