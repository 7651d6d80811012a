//! Trajectories of the TUM RGB-D benchmark (`tum`) and of KITTI (`kitti`): poses alone, or with their data set around them.
//!
//! ```text
//! tum     FILE.txt        timestamp tx ty tz qx qy qz qw, camera to world; # comments
//!         rgb.txt         beside it, of the data set: timestamp and file of each picture; else options.pictures
//!         depth.txt       beside it, of the data set: timestamp and file of each depth map, 16 bits, 5000 a metre
//! kitti   FILE.txt        12 numbers of a 3x4 matrix a line, camera to world
//!         image_N         beside it: the pictures; else options.pictures
//!         times.txt       beside it: seconds of each frame
//!         calib.txt       beside it: `P0: ` to `P3: ` and 12 numbers of a projection
//! both    intrinsics.txt  beside it: fx fy cx cy, with k1 k2 p1 p2 (k3) or not, or 9 numbers of a matrix, pixels; else options.focal_px
//!
//! lens       intrinsics.txt, calib.txt, focal_px
//! associate  timestamps of poses to those of pictures
//! tum, kitti
//! ```
//!
//! **What is converted.**
//!
//! * Poses are camera to world with OpenCV axes, as ours. KITTI's are of its left grey camera: with `calib.txt`, those of `image_N` are moved
//!   along its base line to camera N.
//! * Principal points of `calib.txt` are measured from the centre of the first pixel, as OpenCV's calibration gives them: half a pixel
//!   is added. Those of `intrinsics.txt` are taken as they are, from the image's corner.
//! * Timestamps of a TUM file are seconds, and frames keep their place in time. Where they are whole numbers that count the
//!   pictures (0, 1, 2, 5, ...: what trackers write) they are numbers of frames.
//! * Depth of a TUM data set is 1/5000 m a step (`depth_unit` says otherwise); what is further than 20 ms from a pose is left out, as in the
//!   benchmark's own `associate.py`. Depth and poses are metric only where the data set is there: `depth.txt` or `calib.txt`.
//!
//! Source: the file formats of the TUM RGB-D benchmark and of KITTI's odometry benchmark (`devkit/readme.txt`).

mod associate;
mod kitti;
mod lens;
mod tum;

pub(super) use kitti::{detect as detect_kitti, list as list_kitti};
pub(super) use tum::{detect as detect_tum, list as list_tum};
