//! What several formats read.
//!
//! ```text
//! file      whole files and JSON, within a limit
//! table     lines of numbers
//! arrays    arrays of an npz archive, by any of several names, their shapes compared
//! pose      matrices and quaternions to camera-to-world
//! pictures  a folder or a video as pictures of known size
//! depth     one depth map: PNG, npy, npz, EXR
//! clock     frames a second, times in frames
//! ```

pub(crate) mod arrays;
pub(crate) mod clock;
pub(crate) mod depth;
pub(crate) mod exr;
pub(crate) mod file;
pub(crate) mod pictures;
pub(crate) mod pose;
pub(crate) mod table;
