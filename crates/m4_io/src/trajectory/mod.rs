//! Reads camera paths for rendering.
//!
//! Four layouts of JSON are read, distinguished by their keys. Two list a camera an image:
//!
//! ```text
//! transforms.json   frames[].transform_matrix, fl_x .. h, time (nerfstudio; as in crate::capture,
//!                   without images)
//! camera_path.json  camera_path[].camera_to_world (16 numbers, row-major), fov (vertical, degrees),
//!                   render_time; render_width, render_height, fps, camera_type; OpenGL axes
//! ```
//!
//! and two hold keyframes, between which the caller interpolates ([`Keyed`]):
//!
//! ```text
//! minute4d-path     our own, described in docs/paths.md
//! camera_path.json  keyframes[].matrix without camera_path: row-major numbers, or column-major text
//!                   as the viewer wrote them up to version 0.3
//! ```

mod error;
mod file;
mod keyed;
mod listed;
mod nerfstudio;
mod own;

pub use error::ReadTrajectoryError;
pub use file::{Listed, Trajectory, load, read};
pub use keyed::{KeyPose, Keyed, Keyframe, SceneTime};
