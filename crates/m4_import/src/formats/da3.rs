//! Depth Anything 3 and DA3-Streaming.
//!
//! ```text
//! exports/npz/results.npz        image u8 [n][h][w][3], depth [n][h][w], conf, extrinsics [n][3][4] or [n][4][4], intrinsics [n][3][3]
//! exports/mini_npz/results.npz   the same without image: the pictures come from options.pictures
//! FOLDER/camera_poses.txt        DA3-Streaming: 16 numbers a frame, row by row
//! FOLDER/intrinsic.txt           fx fy cx cy a frame
//! FOLDER/results_output/frame_I.npz   image, depth, conf, intrinsics of frame I
//! ```
//!
//! **What is converted.** `extrinsics` are world to camera and are inverted; `camera_poses.txt` is camera to world. Axes are
//! OpenCV's. Intrinsics are in pixels of the depth maps; pictures of another size get them scaled. Principal points are taken as they
//! are, from the image's corner: the network sets them to about half of the width, which is what that means. Depth of which nothing
//! is known (no number, or not above 0) becomes 0; `conf` is not used. Whether a scene is in metres depends on the network, which the
//! files do not name: it is taken as not. There is no clock: frames are evenly spaced.
//!
//! Source: `depth_anything_3/utils/export/npz.py` and `da3_streaming/da3_streaming.py` of ByteDance's repository (Apache-2.0).

use super::dump::{self, Keys};
use crate::core::{FrameSource, ImportOptions, Lens, ListedFrame, Listing, ReadSourceError, SourceFault};
use crate::files::arrays::{self, Arrays};
use crate::files::{Inside, clock, folder_of, lens, listed, pose, stem, table};
use m4_io::npy::Npz;
use m4_scene::Progress;
use std::path::{Path, PathBuf};

const KEYS: Keys = Keys {
    images: &["image", "images"],
    depth: &["depth"],
    w2c: &["extrinsics"],
    c2w: &[],
    intrinsics: &["intrinsics"],
};

/// Whether it is an export of DA3, a folder with one, or one of DA3-Streaming.
pub(super) fn detect(path: &Path) -> bool {
    results(path).is_some_and(|file| has_keys(&file)) || is_streaming(path)
}

fn is_streaming(path: &Path) -> bool {
    ["camera_poses.txt", "intrinsic.txt"]
        .iter()
        .all(|name| path.join(name).is_file())
}

fn has_keys(file: &Path) -> bool {
    let keys = ["depth", "extrinsics", "intrinsics"];
    matches!(Npz::open(file), Ok(Ok(npz)) if keys.iter().all(|key| npz.has(key)))
}

/// The archive at `path`, or where an export of it is.
fn results(path: &Path) -> Option<PathBuf> {
    let is_npz = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("npz"));
    if path.is_file() {
        return is_npz.then(|| path.to_path_buf());
    }
    let places = [
        "results.npz",
        "npz/results.npz",
        "exports/npz/results.npz",
        "mini_npz/results.npz",
        "exports/mini_npz/results.npz",
    ];
    places.iter().map(|place| path.join(place)).find(|file| file.is_file())
}

pub(super) fn list(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Listing, ReadSourceError> {
    if is_streaming(path) {
        return streaming(path, options, progress);
    }
    let file = results(path).ok_or_else(|| {
        let remedy = "give results.npz or the folder of the export, or that of DA3-Streaming with camera_poses.txt";
        SourceFault::missing("results.npz", remedy).at(path)
    })?;
    let file = Inside::of(folder_of(path), options).file(file)?;
    dump::list(&file, &KEYS, options, progress)
}

fn streaming(folder: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Listing, ReadSourceError> {
    clock::fps(options).map_err(|fault| fault.at(folder))?;
    let poses_file = folder.join("camera_poses.txt");
    let poses = table::read(&poses_file, |n| n == 16, "16 numbers of a matrix")?;
    let lens_file = folder.join("intrinsic.txt");
    let lenses = table::read(&lens_file, |n| n == 4, "fx fy cx cy")?;
    let frames = Inside::of(folder, options).files(frame_files(&folder.join("results_output"))?)?;
    if lenses.len() != poses.len() || frames.len() != poses.len() {
        let what = format!(
            "it has {} poses, but there are {} lines in intrinsic.txt and {} files in results_output",
            poses.len(),
            lenses.len(),
            frames.len()
        );
        return Err(SourceFault::bad(what, "give the whole folder of one run").at(&poses_file));
    }
    let mut train = Vec::with_capacity(poses.len());
    for (i, ((pose, k), file)) in poses.iter().zip(&lenses).zip(frames).enumerate() {
        let c2w =
            pose::of_matrix("the matrix", &pose.values).map_err(|fault| fault.within(&poses_file, pose.place()))?;
        let (_, w, h) = Arrays::open(&file, options)?.map_shape("depth")?;
        let k = lens::pinhole([k.values[0], k.values[1], k.values[2], k.values[3]], (w, h));
        let (rgb_file, depth_file, options, quiet) = (file.clone(), file, options.clone(), options.clone());
        let rgb = FrameSource::new(move || {
            let mut arrays = Arrays::open(&rgb_file, &options).map_err(arrays::inner)?;
            arrays.only_picture("image").map_err(arrays::inner)
        });
        train.push(ListedFrame {
            depth: Some(FrameSource::new(move || {
                let mut arrays = Arrays::open(&depth_file, &quiet).map_err(arrays::inner)?;
                arrays.only_map("depth").map_err(arrays::inner)
            })),
            ..ListedFrame::new(format!("{i:05}"), Lens::pinhole(k), c2w, i as f64, rgb)
        });
    }
    let n = train.len();
    Ok(Listing::of_video(train, n, clock::duration_s(n, options, progress)))
}

/// The files `frame_I.npz` in order.
fn frame_files(folder: &Path) -> Result<Vec<PathBuf>, ReadSourceError> {
    let missing = || {
        let remedy = "run DA3-Streaming with `save_depth_conf_result: True`: its pictures and depth are in it";
        SourceFault::missing("the folder results_output with frame_0.npz, frame_1.npz, ...", remedy).at(folder)
    };
    if !folder.is_dir() {
        return Err(missing());
    }
    let mut files = listed(folder, &["npz"])?;
    files.retain(|file| stem(file).starts_with("frame_"));
    if files.is_empty() {
        return Err(missing());
    }
    Ok(files)
}
