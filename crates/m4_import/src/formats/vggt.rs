//! Archives of VGGT and of networks that name their arrays alike (VGGT-Long, Pi3X, StreamVGGT, MapAnything's dumps).
//!
//! ```text
//! extrinsic (or extrinsics)   [n][3][4] or [n][4][4], world to camera; or camera_poses [n][4][4], camera to world (Pi3)
//! intrinsic (or intrinsics)   [n][3][3], pixels of the depth maps
//! depth (depths, depth_map)   [n][h][w][1] or [n][h][w]
//! images (image, rgb)         [n][3][h][w] or [n][h][w][3], 0 to 1 or bytes; else options.pictures
//! world_points, conf, ...     are not read
//! ```
//!
//! A leading dimension of batches of length 1 is dropped.
//!
//! **What is converted.** Poses world to camera are inverted; axes are OpenCV's. Principal points are taken as they are, from the
//! image's corner: VGGT sets them to half of the width and height. Pictures of another size than the depth maps get the intrinsics
//! scaled. The scale of the scene is arbitrary, and there is no clock: frames are evenly spaced.
//!
//! Source: `predictions` of VGGT's `demo_gradio.py` (`extrinsic`, `intrinsic`, `depth`, `images`), as its users save them.

use super::dump::{self, Keys};
use crate::core::{ImportOptions, Listing, ReadSourceError};
use m4_io::npy::Npz;
use m4_scene::Progress;
use std::path::Path;

const KEYS: Keys = Keys {
    images: &["images", "image", "rgb"],
    depth: &["depth", "depths", "depth_map"],
    w2c: &["extrinsic", "extrinsics"],
    c2w: &["camera_poses"],
    intrinsics: &["intrinsic", "intrinsics"],
};

/// Whether it is such an archive.
pub(super) fn detect(path: &Path) -> bool {
    let is_npz = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("npz"));
    if !(is_npz && path.is_file()) {
        return false;
    }
    let Ok(Ok(npz)) = Npz::open(path) else {
        return false;
    };
    let has = |names: &[&str]| names.iter().any(|name| npz.has(name));
    has(KEYS.depth) && has(KEYS.intrinsics) && (has(KEYS.w2c) || has(KEYS.c2w))
}

pub(super) fn list(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Listing, ReadSourceError> {
    dump::list(path, &KEYS, options, progress)
}
