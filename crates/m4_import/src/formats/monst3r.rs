//! Folders of MonST3R.
//!
//! ```text
//! pred_traj.txt           time x y z and a quaternion a frame, camera to world
//! pred_intrinsics.txt     9 numbers of a matrix a frame, pixels of the depth maps
//! frame_0000.npy          depth [h][w]
//! frame_0000.png          the picture as the network saw it; or options.pictures
//! dynamic_mask_0.png      255 where something moves (optional)
//! conf_0.npy, ...         are not read
//! ```
//!
//! **What is converted.**
//!
//! * The quaternion. The file looks like a trajectory of the TUM benchmark, which ends in `qx qy qz qw`, but MonST3R writes
//!   `qw qx qy qz`. Programs that were made from it (CUT3R and others) write the other order. Both are smooth and of length 1, so only
//!   the first pose tells: the world is about the first camera's, so its `qw` is the largest. Where the first number is the
//!   largest, or neither is above 0.9, it is MonST3R's order; where the last one is above 0.9, the order of the benchmark is taken and a warning
//!   says so.
//! * Principal points are taken as they are, from the image's corner: MonST3R sets them to half of the width and height.
//! * Depth is z-depth in the unit of the poses, which is arbitrary; what is not above 0 is unknown. Frames are evenly spaced.
//!
//! Source: `dust3r/cloud_opt/base_opt.py` and `dust3r/utils/vo_eval.py` of MonST3R's repository, read to learn what they write.

use crate::core::{FrameSource, ImportOptions, Lens, ListedFrame, Listing, ReadSourceError, SourceFault};
use crate::files::pictures::{self, Picture};
use crate::files::table::{self, Row};
use crate::files::{Inside, clock, lens, pose};
use crate::side::depth;
use m4_io::image;
use m4_scene::{CompactMask, Progress};
use std::path::Path;

/// From which size on a number of the first quaternion is taken for `qw`.
const SURE: f64 = 0.9;

/// Whether it is such a folder.
pub(super) fn detect(path: &Path) -> bool {
    ["pred_traj.txt", "pred_intrinsics.txt"]
        .iter()
        .all(|name| folder(path).join(name).is_file())
}

/// The folder, also of the trajectory in it.
fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if path.file_name().is_some_and(|name| name == "pred_traj.txt") => parent,
        _ => path,
    }
}

pub(super) fn list(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Listing, ReadSourceError> {
    clock::fps(options).map_err(|fault| fault.at(path))?;
    let path = folder(path);
    let poses_file = path.join("pred_traj.txt");
    let poses = table::read(&poses_file, |n| n == 8, "time x y z qw qx qy qz")?;
    let lens_file = path.join("pred_intrinsics.txt");
    let lenses = table::read(&lens_file, |n| n == 9, "9 numbers of a matrix")?;
    if lenses.len() != poses.len() {
        let what = format!(
            "it has {} poses, but pred_intrinsics.txt has {} lines",
            poses.len(),
            lenses.len()
        );
        return Err(SourceFault::bad(what, "give the whole folder of one run").at(&poses_file));
    }
    let benchmark = benchmark_order(&poses[0], progress);
    let mut given = match &options.pictures {
        Some(folder) => {
            let all = pictures::read(folder, &Inside::named(folder, options), options, progress)?.all;
            if all.len() != poses.len() {
                let what = format!("it has {} pictures, but there are {} poses", all.len(), poses.len());
                return Err(SourceFault::bad(what, "give those of the run").at(folder));
            }
            Some(all.into_iter())
        }
        None => None,
    };
    let inside = Inside::of(path, options);
    let mut train = Vec::with_capacity(poses.len());
    for (i, (pose, k)) in poses.iter().zip(&lenses).enumerate() {
        let picture = given.as_mut().and_then(Iterator::next);
        let frame = frame((path, &inside), i, picture, &k.values);
        let mut frame = frame.map_err(|fault| fault.within(path, format!("frame {i}")))?;
        let v = &pose.values;
        let q = if benchmark {
            [v[7], v[4], v[5], v[6]]
        } else {
            [v[4], v[5], v[6], v[7]]
        };
        let c2w = pose::of_quaternion([v[1], v[2], v[3]], q);
        frame.c2w = c2w.map_err(|fault| fault.within(&poses_file, pose.place()))?;
        train.push(frame);
    }
    let n = train.len();
    Ok(Listing::of_video(train, n, clock::duration_s(n, options, progress)))
}

/// Whether quaternions end in `qw`.
fn benchmark_order(first: &Row, progress: &dyn Progress) -> bool {
    let (ours, theirs) = (first.values[4].abs(), first.values[7].abs());
    let benchmark = theirs > SURE && theirs > ours;
    if benchmark {
        progress.warn("the quaternions of pred_traj.txt were taken as qx qy qz qw: the first one says so; MonST3R itself writes qw first");
    }
    benchmark
}

/// A frame without its pose.
fn frame(
    (folder, inside): (&Path, &Inside),
    i: usize,
    picture: Option<Picture>,
    k: &[f64],
) -> Result<ListedFrame, SourceFault> {
    let depth_file = inside.check(folder.join(format!("frame_{i:04}.npy")))?;
    let picture = match picture {
        Some(picture) => picture,
        None => {
            let file = folder.join(format!("frame_{i:04}.png"));
            if !file.is_file() {
                let remedy = "or give the folder of the pictures (pictures)";
                return Err(SourceFault::missing(format!("the picture {}", file.display()), remedy));
            }
            pictures::of_file(&inside.check(file)?)?
        }
    };
    // the network's own pictures are of the size of the depth maps; others are scaled to it
    let seen = folder.join(format!("frame_{i:04}.png"));
    let seen = if seen.is_file() {
        pictures::size_of(&seen)?
    } else {
        depth_size(&depth_file)?
    };
    let k = lens::of_matrix(k, seen)?;
    if !depth_file.is_file() {
        let what = format!("the depth map {}", depth_file.display());
        return Err(SourceFault::missing(what, "give the whole folder of one run"));
    }
    let mask_file = inside.check(folder.join(format!("dynamic_mask_{i}.png")))?;
    let lens = Lens::pinhole(lens::scaled(&k, picture.size)?);
    Ok(ListedFrame {
        depth: Some(depth::source(depth_file, 1.0, 1.0)),
        mask: mask_file
            .is_file()
            .then(|| FrameSource::new(move || Ok(CompactMask::from(image::read_grey(&mask_file)?)))),
        ..ListedFrame::new(picture.name, lens, m4_math::Se3::identity(), i as f64, picture.rgb)
    })
}

/// Width and height of a depth map.
fn depth_size(file: &Path) -> Result<(usize, usize), SourceFault> {
    let map = depth::read_depth(file, 1.0).map_err(|fault| fault.of_file(file))?;
    Ok(map.size())
}
