//! Camera paths to render along.
//!
//! Three layouts of JSON are read, told apart by their keys:
//!
//! ```text
//! transforms.json   frames[].transform_matrix, fl_x .. h, time (nerfstudio; as in crate::capture,
//!                   without pictures)
//! camera_path.json  camera_path[] or keyframes[]: camera_to_world or matrix (16 numbers, row-major;
//!                   matrix: column-major text, as the nerfstudio viewer writes keyframes), fov
//!                   (vertical, degrees); render_width, render_height; OpenGL axes
//! ```

mod error;
mod read;

pub use error::ReadTrajectoryError;
pub use read::read;
