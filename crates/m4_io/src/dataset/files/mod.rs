//! The files of a source: reading within a memory limit, and parsing.
//!
//! ```text
//! bytes      whole files, text
//! json       JSON, of a file or of a member of an archive
//! npy        an array in a .npy file; opening archives of arrays (.npz)
//! arrays     small arrays of an archive: poses, lenses
//! zipped     members of a zip archive, or of the folder that it was unpacked to
//! names      files of a folder in order, names below a folder
//! inside     which files may be read: by their names and by links they may lead elsewhere
//! images     a folder or a video as images of known size
//! lens       pinholes, and whether they fit images of a size
//! pose       matrices and quaternions to camera to world
//! clock      frames per second, times in frames
//! ```
//!
//! Faults of a file beside the source are named by [`SourceErrorCause::of_file`](crate::dataset::SourceErrorCause::of_file).

pub(crate) mod arrays;
pub(crate) mod clock;
pub(crate) mod images;
pub(crate) mod lens;
pub(crate) mod npy;
pub(crate) mod pose;

mod bytes;
mod inside;
mod json;
mod names;
mod zipped;

pub(crate) use bytes::{bytes, text};
pub(crate) use inside::Inside;
pub(crate) use json::{json, parse_json};
pub(crate) use names::{below, first_bytes, listed, stem};
pub(crate) use zipped::Members;
