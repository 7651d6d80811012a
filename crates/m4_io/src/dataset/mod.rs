//! Imports clips with poses from other tools as captures for training.
//!
//! ```text
//! data sets          dycheck, nvidia; davis, which has no poses and is read by itself
//! phones             record3d
//! reconstructions    colmap, nerfstudio, vipe, megasam
//!
//! path -> detect -> the format's list -> Listing: lens, pose, time and the places of images, depth and masks
//!      -> side::attach: depth maps and masks that the options name
//!      -> load: everything decoded in parallel within a memory limit, distortion removed -> Imported
//! ```
//!
//! A format is one file or folder: its parser, and at the top the conventions that it converts.
//! What it lists is in ours (OpenCV axes, camera to world, z-depth, principal points measured from
//! the image's corner), and everything that follows is the same for all.
//!
//! Files are not trusted: counts are compared with the size of the file before memory is taken.

pub mod colmap;
pub mod davis;
pub mod depth;
pub mod dycheck;
pub mod megasam;
pub mod nerfstudio;
mod nvidia;
mod record3d;
pub mod side;
mod vipe;

mod files;
mod lens;
mod listing;

pub use lens::{Distortion, Lens, Undistort};
pub(crate) use listing::{FrameSource, ListedFrame, Listing, load, step};
pub use listing::{ImportOptions, Imported};

use crate::{Fault, ReadError};
use m4_core::Progress;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A format of posed clips, the special before the general: the order in which they are tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum SourceFormat {
    /// DyCheck's iPhone scenes, and scenes of Nerfies and HyperNeRF in its layout ([`dycheck`]).
    Dycheck,
    /// NVIDIA Dynamic Scenes and other clips with LLFF's `poses_bounds.npy`.
    Nvidia,
    /// Record3D's `.r3d`.
    Record3d,
    /// COLMAP's sparse model with its images.
    Colmap,
    /// `transforms.json` of nerfstudio, Blender, Instant4D, and our own captures.
    Nerfstudio,
    /// Artifacts of ViPE.
    Vipe,
    /// Files of MegaSaM.
    Megasam,
}

/// Bytes of eight pixels: colour, depth of 32 bits, and room for a mask.
const BYTES_PER_8_PIXELS: u64 = 64;

/// Detects a file or folder of a format by names and first bytes.
type Detect = fn(&Path) -> bool;
type List = fn(&Path, &ImportOptions, &dyn Progress) -> Result<Listing, ReadError>;

/// Name and reader of each format, in the order of [`SourceFormat`].
const ROWS: &[(SourceFormat, &str, Detect, List)] = &[
    (
        SourceFormat::Dycheck,
        "dycheck",
        dycheck::detect,
        dycheck::list,
    ),
    (SourceFormat::Nvidia, "nvidia", nvidia::detect, nvidia::list),
    (
        SourceFormat::Record3d,
        "record3d",
        record3d::detect,
        record3d::list,
    ),
    (SourceFormat::Colmap, "colmap", colmap::detect, colmap::list),
    (
        SourceFormat::Nerfstudio,
        "nerfstudio",
        nerfstudio::detect,
        nerfstudio::list,
    ),
    (SourceFormat::Vipe, "vipe", vipe::detect, vipe::list),
    (
        SourceFormat::Megasam,
        "megasam",
        megasam::detect,
        megasam::list,
    ),
];

impl SourceFormat {
    /// All variants.
    pub fn all() -> impl Iterator<Item = Self> {
        ROWS.iter().map(|row| row.0)
    }

    /// Returns the name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        ROWS.iter()
            .find(|row| row.0 == self)
            .map_or("", |row| row.1)
    }
}

/// The format of what is at `path`, by names and first bytes; `None` if it is none of these.
#[must_use]
pub fn detect(path: &Path) -> Option<SourceFormat> {
    ROWS.iter().find(|row| (row.2)(path)).map(|row| row.0)
}

/// Reads a file or folder of that format; depth and masks that the options name take the place of
/// its own.
pub fn read(
    path: &Path,
    format: SourceFormat,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Imported, ReadError> {
    let Some((_, _, _, list)) = ROWS.iter().find(|row| row.0 == format) else {
        return Err(Fault::unsupported("no reader has this format", "name another").at(path));
    };
    let mut listing = list(path, options, progress)?;
    side::attach(&mut listing, options)?;
    load(path, listing, BYTES_PER_8_PIXELS, options, progress)
}
