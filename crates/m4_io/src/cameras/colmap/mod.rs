//! COLMAP's sparse model: `cameras`, `images` and `points3D`, as text or binary.
//!
//! ```text
//! cameras    id, model, width, height, parameters      PINHOLE: fx fy cx cy, pixels; the centre of the
//!                                                      first pixel is (0.5, 0.5), as here
//! images     id, qw qx qy qz, tx ty tz, camera, name   world to camera, OpenCV axes; then the points that
//!                                                      it sees (none here)
//! points3D   id, x y z, r g b, error, track            splats of one instant with their colours; error -1
//!                                                      (unknown), no track
//! ```
//!
//! [`read()`] takes models of pinholes; [`read_tables`] gives the lenses of all models as they are, for who can undistort images.
//!
//! In binary files counts are u64, identifiers of cameras and images u32, numbers f64, all little-endian.
//! The names of the folders are the caller's (COLMAP's own is `sparse/0`). Rigs and frames, which
//! COLMAP 3.12 added, are left to it: it makes the trivial ones where the files are missing.
//!
//! Source: COLMAP's documentation, "Output Format".

mod binary;
mod error;
mod model;
mod read;
mod text;
mod write;

pub use error::{ReadColmapError, WriteColmapError};
pub use model::{ColmapCamera, ColmapImage, ColmapModel, ColmapPoint, ColmapPose, ColmapTables};
pub use read::{read, read_tables};
pub use write::{ColmapEncoding, ColmapOptions, write};

pub(crate) use model::Tables;
pub(crate) use write::write_tables;
