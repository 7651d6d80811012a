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
//! * Poses: `cam_c2w` is camera to world with OpenCV axes, as ours; `poses` is
//!   `tx ty tz qx qy qz qw`, world to camera.
//! * Depth: z-depth in the unit of the poses; `disps` is `1 / (depth + 1e-6)`. Unknown (0 here) is
//!   what MegaSaM itself takes for unknown: below 0.01, or in the clipped form at the lower end, or
//!   NaN. The unit is a metre times a factor that MegaSaM divides by and does not save, so a
//!   capture that is read is not metric.
//! * `motion_prob` is **high where things are static** (it weighs the bundle adjustment). The
//!   probability of motion is `1 - m`; a pixel is dynamic where that is above 0.7, the paper's
//!   tau_motion, after `m` was resized bilinearly to the image. Where more than 60 % of the pixels
//!   are dynamic, the map is probably one of the other polarity, and a warning says so.
//! * Principal point: **the numbers are taken as they are**, as measured from the image's corner,
//!   where the centre of the first pixel is at (0.5, 0.5). MegaSaM sets `cx = W/2` and then counts
//!   pixels from their corners in some places (normals, and Instant4D's lifting of its files) and
//!   from their centres in others (tracking, flow loss), so no choice agrees with all of it. This
//!   one is what `W/2` means for a camera, and what the readers of these files assume. Against the
//!   rays of the tracker it turns every camera by the same half pixel, about 0.05 degrees at 500
//!   pixels of focal length.
//! * Time: the files have no clock. Frames are evenly spaced at
//!   [`ImportOptions::fps`](super::ImportOptions::fps).
//!
//! Files are not trusted: see `crate::npy` for sizes, and every number is checked.

mod read;

pub(super) use read::list;

use crate::Fault;
use crate::npy::Npz;
use crate::range::DEPTH;
use m4_core::{CompactMask, Progress};
use std::path::{Path, PathBuf};

/// Whether it is a folder of reconstructions, or an archive with `cam_c2w`.
pub(super) fn detect(path: &Path) -> bool {
    detect_name(path) && (path.is_dir() || matches!(Npz::open(path), Ok(npz) if npz.has("cam_c2w")))
}

/// Whether it is a folder with the files of a reconstruction, or has the name of an archive
/// (`NAME.npz`).
#[must_use]
pub fn detect_name(path: &Path) -> bool {
    if path.is_dir() {
        let all = ["images.npy", "poses.npy", "intrinsics.npy"];
        return all.iter().all(|name| path.join(name).is_file());
    }
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("npz"))
}

/// Name of the file.
const FILE: &str = "motion_prob.npy";
/// A pixel is dynamic where its probability of motion is above this (tau_motion of the paper).
const TAU_MOTION: f64 = 0.7;
/// Pixels to a side of what one number stands for.
const BLOCK: usize = 8;
/// Above this share of dynamic pixels, the map is probably inverted.
const MAX_DYNAMIC: f64 = 0.6;
/// How far rounding may put a probability outside of 0 to 1.
const ROUNDING: f64 = 1e-3;

/// Where the file of the clip at `path` may be: in the folder of reconstructions itself; of
/// `NAME_droid.npz` in `reconstructions/NAME` beside it or beside its folder (MegaSaM writes
/// `outputs/` and `reconstructions/` side by side), else right beside it.
fn candidates(path: &Path) -> Vec<PathBuf> {
    if path.is_dir() {
        return vec![path.join(FILE)];
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut all = Vec::new();
    if let Some(scene) = path.file_stem().and_then(|s| s.to_str()).map(scene_name) {
        for base in [folder, &folder.join("..")] {
            all.push(base.join("reconstructions").join(scene).join(FILE));
        }
    }
    all.push(folder.join(FILE));
    all
}

/// `dog` of `dog_droid` and `dog_sgd_cvd_hr`.
fn scene_name(stem: &str) -> &str {
    let ends = ["_sgd_cvd_hr", "_sgd_cvd", "_cvd", "_droid"];
    ends.iter()
        .find_map(|end| stem.strip_suffix(end))
        .unwrap_or(stem)
}

/// The mask of frame `frame` of `size` from the `map` of `of` numbers, row by row.
fn mask_of(
    frame: usize,
    map: &[f64],
    of: (usize, usize),
    size: (usize, usize),
) -> Result<CompactMask, Fault> {
    if let Some(value) = map
        .iter()
        .find(|m| !(-ROUNDING..=1.0 + ROUNDING).contains(*m))
    {
        let what = format!("frame {frame} of the array `motion_prob` holds {value}");
        return Err(Fault::bad(what, "0 (dynamic) to 1 (static) was expected"));
    }
    let across = taps(of.0, size.0);
    let down = taps(of.1, size.1);
    let at = |x: usize, y: usize| {
        let ((x0, x1, fx), (y0, y1, fy)) = (across[x], down[y]);
        let row = |y: usize| map[y * of.0 + x0] * (1.0 - fx) + map[y * of.0 + x1] * fx;
        row(y0) * (1.0 - fy) + row(y1) * fy
    };
    Ok(CompactMask::from_fn(size.0, size.1, |x, y| {
        1.0 - at(x, y) > TAU_MOTION
    }))
}

/// The two neighbours of each of `to` pixels and the weight of the second: bilinear, by pixel
/// centres, edges repeated.
fn taps(from: usize, to: usize) -> Vec<(usize, usize, f64)> {
    let last = (from - 1) as f64;
    (0..to)
        .map(|i| {
            let at = ((i as f64 + 0.5) * from as f64 / to as f64 - 0.5).clamp(0.0, last);
            let first = at.floor() as usize;
            (first, (first + 1).min(from - 1), at - at.floor())
        })
        .collect()
}

/// Warns of masks with an improbable share of dynamic pixels.
fn check_polarity<'a>(masks: impl Iterator<Item = &'a CompactMask>, progress: &dyn Progress) {
    let (mut dynamic, mut all) = (0, 0);
    for mask in masks {
        dynamic += mask.count();
        all += mask.size().0 * mask.size().1;
    }
    let share = dynamic as f64 / all.max(1) as f64;
    if share > MAX_DYNAMIC {
        progress.warn(&format!(
            "{:.0} % of the pixels count as dynamic: motion_prob is high in static regions, and this file is \
             probably inverted; save 1 - motion_prob and import again",
            100.0 * share
        ));
    }
}

/// MegaSaM takes depth below this for unknown before it tracks.
const LEAST_DEPTH: f64 = 1e-2;
/// Least depth of the clipped form.
const LEAST_CLIPPED: f64 = 1e-3;
/// MegaSaM adds this to depth before it takes the inverse.
const DISPARITY_EPSILON: f64 = 1e-6;

/// How depth is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stored {
    /// As it is.
    Depth,
    /// Clipped, with unknown at the lower end.
    Clipped,
    /// As disparity.
    Disparity,
}

/// Depth of a stored number; 0 where unknown.
fn depth_of(stored: Stored, value: f64) -> f32 {
    let (z, least) = match stored {
        Stored::Depth => (value, LEAST_DEPTH),
        // half rounds the bound to 1.00040e-3
        Stored::Clipped => (value, LEAST_CLIPPED * 1.001),
        Stored::Disparity => (1.0 / value - DISPARITY_EPSILON, LEAST_DEPTH),
    };
    // `z < least` would let NaN pass; the inverse of a tiny disparity is finite, but not as 32 bits
    let in_range = z >= least && DEPTH.contains(&z);
    if in_range { z as f32 } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::{Stored, candidates, depth_of, mask_of};
    use std::path::Path;

    #[test]
    fn high_motion_values_are_static_and_resized_bilinearly() {
        // one row: static, dynamic; the middle between them is at column 8 of 16
        let held = mask_of(0, &[1.0, 0.0], (2, 1), (16, 1)).unwrap();
        let dynamic: Vec<bool> = (0..16).map(|x| held.at(x, 0)).collect();
        // motion at column x is (x + 0.5 - 4) / 8: above 0.7 from x = 9.1 on
        assert_eq!(dynamic, (0..16).map(|x| x >= 10).collect::<Vec<_>>());
        assert!(mask_of(4, &[f64::NAN], (1, 1), (8, 8)).is_err());
        assert!(
            mask_of(4, &[1.5], (1, 1), (8, 8))
                .unwrap_err()
                .to_string()
                .contains("frame 4")
        );
    }

    #[test]
    fn motion_map_candidates_follow_megasam_folders() {
        let at = candidates(Path::new("out/outputs_cvd/dog_sgd_cvd_hr.npz"));
        assert!(
            at.contains(&"out/outputs_cvd/../reconstructions/dog/motion_prob.npy".into()),
            "{at:?}"
        );
        assert_eq!(
            at.last().unwrap(),
            Path::new("out/outputs_cvd/motion_prob.npy")
        );
    }

    #[test]
    fn unknown_depth_stays_unknown() {
        for stored in [Stored::Depth, Stored::Clipped] {
            assert_eq!(depth_of(stored, 3.25), 3.25);
        }
        assert!((depth_of(Stored::Disparity, 1.0 / 3.25) - 3.25).abs() < 1e-5);
        // what numpy's clip of MegaSaM leaves of NaN and of infinity
        assert_eq!(depth_of(Stored::Clipped, f64::NAN), 0.0);
        assert_eq!(depth_of(Stored::Clipped, 1e-3), 0.0);
        assert_eq!(depth_of(Stored::Clipped, 100.0), 100.0);
        assert_eq!(depth_of(Stored::Disparity, 0.0), 0.0);
        assert_eq!(depth_of(Stored::Disparity, 1e-40), 0.0);
        assert_eq!(depth_of(Stored::Depth, 1e300), 0.0);
        assert_eq!(depth_of(Stored::Depth, 1e-6), 0.0);
    }
}
