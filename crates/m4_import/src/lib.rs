//! Imports clips with poses from other tools as captures for training.
//!
//! ```text
//! formats     which format a path is of; a file or folder -> Listing: lens, pose, time and the places of images, depth and masks
//! files       what formats read: bytes within a limit, JSON, tables, arrays, zip members, images, lenses, poses, time
//! side        depth maps, masks and tracks: of formats, and those that the options name, to the frames of any listing
//! core/load   Listing -> Capture: everything decoded in parallel within a limit of memory, distortion removed
//! ```
//!
//! A format is one file or folder of [`formats`]: its parser, and at the top the conventions that it converts. What it lists is in ours
//! (OpenCV axes, camera to world, z-depth, principal points measured from the image's corner), and everything that follows is
//! the same for all.
//!
//! Files are not trusted: counts are compared with the size of the file before memory is taken.
#![forbid(unsafe_code)]

pub mod formats;
pub mod side;

mod core;
mod files;

pub use core::{
    Distortion, FrameSource, ImportOptions, Imported, Lens, ListedFrame, Listing, ReadSourceError, SourceFault, load,
};
pub use formats::{SourceFormat, detect, read};
