//! Files of MegaSaM.
//!
//! ```text
//! NAME_droid.npz         images u8 [n][h][w][3] RGB    depths f32 [n][h][w]    intrinsic f64 [3][3]    cam_c2w f32 [n][4][4]
//! NAME_sgd_cvd_hr.npz    the same with depths f16, clipped to 0.001 .. 100; variants call them depths_raw
//! reconstructions/NAME/  images.npy u8 [n][3][h][w] BGR    disps.npy [n][h][w]    poses.npy [n][7]    intrinsics.npy [n][4]
//!                        motion_prob.npy [n][h/8][w/8]
//!
//! read:   file or folder -> shapes compared -> lenses, poses -> images, depth, masks -> Listing
//! ```
//!
//! Source: docs/spec/front-end.md 1.9, and the scripts of MegaSaM (Li et al. 2025; Apache-2.0)
//! that write these files, read to learn what they hold.
//!
//! **What is converted, here and nowhere else.**
//!
//! * Poses: `cam_c2w` is camera to world with OpenCV axes, as ours; `poses` is `tx ty tz qx qy qz qw`, world to camera.
//! * Depth: z-depth in the unit of the poses; `disps` is `1 / (depth + 1e-6)`. Unknown (0 here) is what MegaSaM itself
//!   takes for unknown: below 0.01, or in the clipped form at the lower end, or NaN. The unit is a metre times a
//!   factor that MegaSaM divides by and does not save, so a capture that is read is not metric.
//! * `motion_prob` is **high where things are static** (it weighs the bundle adjustment). The probability of motion is
//!   `1 - m`; a pixel is dynamic where that is above `tau_motion`, after `m` was resized bilinearly to the image. Where more
//!   than 60 % of the pixels are dynamic, the map is probably one of the other polarity, and a warning says so.
//! * Principal point: **the numbers are taken as they are**, as measured from the image's corner, where the centre of
//!   the first pixel is at (0.5, 0.5). MegaSaM sets `cx = W/2` and then counts pixels from their corners in some places
//!   (normals, and Instant4D's lifting of its files) and from their centres in others (tracking, flow loss), so no
//!   choice agrees with all of it. This one is what `W/2` means for a camera, and what the readers of these files
//!   assume. Against the rays of the tracker it turns every camera by the same half pixel, about 0.05
//!   degrees at 500 pixels of focal length.
//! * Time: the files have no clock. Frames are evenly spaced at [`ImportOptions::fps`](super::ImportOptions::fps).
//!
//! Files are not trusted: see `crate::npy` for sizes, and every number is checked.

mod depth;
mod motion;
mod read;

pub(super) use read::list;

use crate::npy::Npz;
use std::path::Path;

/// Whether it is a folder of reconstructions, or an archive with `cam_c2w`.
pub(super) fn detect(path: &Path) -> bool {
    detect_name(path) && (path.is_dir() || matches!(Npz::open(path), Ok(Ok(npz)) if npz.has("cam_c2w")))
}

/// Whether it is a folder with the files of a reconstruction, or has the name of an archive (`NAME.npz`).
#[must_use]
pub fn detect_name(path: &Path) -> bool {
    if path.is_dir() {
        let all = ["images.npy", "poses.npy", "intrinsics.npy"];
        return all.iter().all(|name| path.join(name).is_file());
    }
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("npz"))
}
