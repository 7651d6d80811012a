//! Tracks as `tracks.npz`, with the array names of TAPIP3D, so that its files can be read directly.
//!
//! ```text
//! coords   [frames][tracks][3]   float32   world units; NaN where unknown
//! visibs   [frames][tracks]      bool (or 8-bit integers)
//! colors   [tracks][3]           uint8     optional, sRGB
//! confidence [frames][tracks]    uint8     optional, of the places: 255 is sure (ours; not known to TAPIP3D)
//! ```
//!
//! Other members of the archive are passed over. Files are not trusted: shapes are compared with the clip and with
//! the memory allowed before anything is read, and no member is read further than its shape says.
//!
//! Headers of arrays are those of `crate::npy`.

mod error;
mod read;
mod write;

pub use error::{ReadTracksError, TracksErrorCause};
pub use read::read;
pub use write::write;
