//! Captures for other tools: images, masks, depth and points, in addition to the cameras that [`crate::cameras`] writes.
//!
//! ```text
//! capture  ->  points of static regions, images, masks, depth  ->  a folder beside its place  ->  read back  ->  its name
//! ```
//!
//! * [`colmap`]: `images/`, `masks/`, `sparse/0/`.
//! * [`nerfstudio`]: `images/`, `masks/`, `depths/`, `points.ply`, `transforms.json`.
//!
//! The dynamic part is 0 in the masks of both folders and left out of the points: their readers rebuild the static part. Conventions
//! (OpenGL axes, polarity of masks, units of depth) are turned in the files of the formats and said there.

pub mod colmap;
pub mod nerfstudio;

mod check;
mod error;
mod pictures;
mod points;
mod staging;

pub use error::WriteCaptureAsError;
pub use points::CapturePoint;
