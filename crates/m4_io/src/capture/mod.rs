//! Captures as folders of posed frames: `transforms_train.json` with images, depth maps and masks.
//!
//! The layout is nerfstudio's with a few keys more:
//!
//! ```text
//! NAME/transforms_train.json      the training video (a lone transforms.json is read too)
//! NAME/transforms_test.json       optional: held-out views
//! fl_x fl_y cx cy w h             pixels; for all frames, or inside a frame for that one. fl_y, cx and cy
//!                                 default to fl_x and the image's centre, w and h to the image's size
//! k1 k2 k3 k4 p1 p2               distortion, which is removed
//! depth_unit_scale_factor         scene units per step of the depth maps, default 0.001
//! axes                            "opengl" (default: x right, y up, z back) or "opencv"
//! metric                          true when a scene unit is a metre; default false
//! duration_s                      seconds from the first to the last frame
//! tracks_path                     optional: tracks.npz, trajectories of points on dynamic objects ([`crate::tracks`]); frames in the order of `frames`
//! time_frames                     of a test split without a training split: how many frames `time` spans
//! frames[]  file_path             image, relative to the JSON file; PNG or JPEG
//!           transform_matrix      4x4 camera-to-world
//!           time                  0..1, first to last training frame; default: the frame's index
//!           depth_file_path       optional: 16-bit PNG of z-depth, 0 = unknown
//!           mask_path             optional: 255 = dynamic
//!           motion_path           optional: how likely a pixel is dynamic, 255 = certainly; any size
//!           instance_path         optional: the object that a pixel shows, the same number in all frames, 0 = none; greyscale PNG of 8
//!                                 or 16 bits, any size
//!           camera                optional: index of a held-out camera
//! ```
//!
//! The reader is that of [`crate::dataset::nerfstudio`].

mod axes;
mod error;
mod options;
mod pose;
mod read;
mod write;

pub use axes::Axes;
pub use error::WriteCaptureError;
pub use options::{CaptureOptions, Split};
pub use pose::{Pose, PoseError};
pub use read::read;
pub use write::{depth_unit, write};

/// The file of tracks that [`write()`] puts beside the list of training frames, if there are tracks.
pub const TRACKS_FILE: &str = "tracks.npz";
