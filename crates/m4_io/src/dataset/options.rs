//! What files do not say.

use crate::capture::Axes;
use crate::reach::Reach;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What the files of a source do not say, and how much of them is read. Each format uses what it has a use for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ImportOptions {
    /// Frames per second, above 0, where the files have no clock; `None` takes 30 and says so.
    pub fps: Option<f64>,
    /// Folder or video of the images, where they lie elsewhere; `None` looks where the format has them.
    #[serde(rename = "images")]
    pub images: Option<PathBuf>,
    /// Folder of depth maps, one per frame in the order of names (PNG of 16 bits, EXR, PFM, npy), or an npz file.
    pub depth: Option<PathBuf>,
    /// Scene units per step of 16-bit depth maps; `None` takes what the format says, or 0.001.
    pub depth_unit: Option<f64>,
    /// Folder of masks, one per frame in the order of names.
    pub masks: Option<PathBuf>,
    /// Masks mean the opposite of what the format says (of formats that say nothing: 255 in dynamic regions).
    pub invert_masks: bool,
    /// File of tracks (npz of TAPIP3D, SpatialTracker, CoTracker).
    pub tracks: Option<PathBuf>,
    /// Axes of the cameras where the format leaves them open; `None` detects them by the files.
    pub axes: Option<Axes>,
    /// A pixel is dynamic where its probability of motion is above this. 0.7 is the paper's tau_motion.
    pub tau_motion: f64,
    /// MegaSaM's `motion_prob`; `None` looks beside the file that is read, and where MegaSaM writes it.
    #[serde(skip)]
    pub motion: Option<PathBuf>,
    /// By what the images of a data set are shrunk (DyCheck: `rgb/2x`); `None` takes what the protocols use.
    pub factor: Option<u32>,
    /// Bytes that the decoded frames (8 per pixel) may take before reading is refused. Default 4 GiB, as of a capture.
    pub max_memory_bytes: u64,
    /// Which images, maps and tracks are read: those in the folder of the source and in what the options above name, or
    /// any. Not a setting: only the command line can allow more.
    #[serde(skip)]
    pub reach: Reach,
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self {
            fps: None,
            images: None,
            depth: None,
            depth_unit: None,
            masks: None,
            invert_masks: false,
            tracks: None,
            axes: None,
            tau_motion: 0.7,
            motion: None,
            factor: None,
            max_memory_bytes: 4 << 30,
            reach: Reach::Inside,
        }
    }
}
