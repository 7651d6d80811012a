//! `transforms.json`: nerfstudio, the synthetic scenes of NeRF and D-NeRF, Instant4D, instant-ngp, and our own captures.
//!
//! ```text
//! PATH                    a JSON file, or a folder with transforms_train.json (and transforms_test.json, or _val) or transforms.json
//! fl_x fl_y cx cy w h     pixels, for all frames or inside one; or camera_angle_x (_y), the field of view, radians
//! camera_model, k1 .. k4, p1, p2, is_fisheye       distortion, which is removed
//! applied_transform, applied_scale                 what was done to the poses after they were computed; it is undone
//! train_filenames, val_filenames, test_filenames   which frames are held out
//! axes, metric, duration_s, tracks_path, depth_unit_scale_factor      of our own captures (crate::capture)
//! frames[]  file_path, transform_matrix, time (0..1), depth_file_path, mask_path, motion_path, instance_path, camera
//!
//! json     the keys as they are in the file, and the lens of a frame
//! list     entries -> frames
//! write    a capture -> the folder of a data set
//! ```
//!
//! **What is converted.**
//!
//! * Axes. Matrices are camera to world. They are OpenGL's (x right, y up, z back) except where `axes` says `opencv`, by the option or
//!   in the file. Where neither says it: a file with one of the keys `camera_angle_x`, `camera_model`, `applied_transform`,
//!   `orientation_override`, `aabb_scale`, `ply_file_path` or `is_fisheye` is one of nerfstudio, Blender or instant-ngp, and OpenGL. A
//!   file without any of them whose frames all have a `time` is laid out as those of Instant4D, whose axes are OpenCV's; it is taken
//!   so, and a warning says it. All others are OpenGL.
//! * Time. `time` runs from 0 to 1 over the training video. Without it frames are in the natural order of their names, evenly spaced.
//! * Depth. PNG files of 16 bits, and numbers of npy and EXR files too, are multiplied by `depth_unit_scale_factor` (0.001 where it
//!   is missing, as in nerfstudio), or by the option `depth_unit`.
//! * Masks. nerfstudio trains where `mask_path` is not 0 and leaves out what is 0: the dynamic part is **0**. Our own captures, told by the
//!   key `axes`, have 255 where something moves. The option `invert_masks` turns both round.
//! * `applied_scale` and `applied_transform` are undone, so that poses are again in the unit of the depth maps and in the world of
//!   the tool that computed them.
//! * The principal point is measured from the image's corner, as ours. `k4` of a lens that is no fisheye is not read: programs
//!   disagree about what it is.
//!
//! Source: nerfstudio's `nerfstudio_dataparser.py`, `depth_dataset.py` and `data_utils.py` (Apache-2.0), `blender_dataparser.py`.

mod json;
mod list;
mod write;

pub use write::write;

pub(crate) use json::{Frame, LensKeys, Transforms, lens_of, rows};
pub(crate) use list::list_capture;
pub(super) use list::{detect, list};
