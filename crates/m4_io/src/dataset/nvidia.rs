//! NVIDIA Dynamic Scenes, and any clip in the layout of LLFF: `poses_bounds.npy` beside folders of
//! images.
//!
//! ```text
//! poses_bounds.npy       [n][17]: 3 x 5 by rows (rotation, centre, height width focal), then the nearest and farthest depth in view
//! images_2/ or images/   n images, in natural order of names; camera i took image i at time i
//! motion_masks/          optional, n masks, not 0 moves
//! disp/                  optional, n maps of relative disparity (npy), of a network
//! gt/ or test/           held-out views vCCC_tTTT.png: camera CCC at time TTT (RoDynRF's results; CCC is 000 there)
//! mv_images/TTTTT/       held-out views camNN.jpg: camera NN - 1 at time TTTTT (NSFF), but for the view that trains
//! ```
//!
//! Columns of the rotation are the camera's down, right and back in the world; in our axes (right,
//! down, forward) they are columns 1, 0 and minus 2. The principal point is the middle. Images may
//! be of any size; height, width and focal length shrink with them. Disparity of the network is
//! known up to scale and shift: both are chosen for each frame so that its 0.1 and 99.9 percent
//! quantiles are those of the bounds, which is how COLMAP's points made these (`imgs2poses.py` of
//! Fyusion/LLFF); `progress` reports this. Sources: `load_llff.py` of
//! zhengqili/Neural-Scene-Flow-Fields, `dataLoader/nvidia.py` of facebookresearch/robust-dynrf.
//!
//! `v000_t000` is the view of the first training image: results compare only if both or neither
//! count it.

use super::depth::depth_in_range;
use super::files::{Inside, StoredImage, given_fps, resized, stored_image};
use super::side::{mask, one_a_frame};
use super::{FrameSource, ImportOptions, Lens, ListedFrame, Listing};
use crate::error::AtPath;
use crate::files::{listed, stem};
use crate::npy::Numbers;
use crate::{Fault, ReadError, pose, range};
use m4_core::{Camera, CompactDepth, DepthMap, Intrinsics, Plane, Progress};
use std::path::{Path, PathBuf};

const EXTENSIONS: &[&str] = &["png", "jpg", "jpeg"];

/// Detects a folder of the format.
pub(crate) fn detect(path: &Path) -> bool {
    path.join("poses_bounds.npy").is_file()
        && (path.join("images").is_dir() || path.join("images_2").is_dir())
}

pub(crate) fn list(
    path: &Path,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Listing, ReadError> {
    let poses = read_bounds(&path.join("poses_bounds.npy"))?;
    let n = poses.len();
    let fps = given_fps(options).at(path)?;
    let folder = image_folder(path, options)?;
    let inside = Inside::of(path, options);
    let images = inside.files(one_a_frame(&folder, EXTENSIONS, "images", n)?)?;
    let optional =
        |name: &str, extensions: &[&str], what: &str| -> Result<Option<Vec<PathBuf>>, ReadError> {
            let folder = path.join(name);
            let listed = || inside.files(one_a_frame(&folder, extensions, what, n)?);
            folder.is_dir().then(listed).transpose()
        };
    let masks = optional("motion_masks", &["png"], "masks")?;
    let disparity = optional("disp", &["npy"], "maps of disparity")?;
    if disparity.is_some() && options.depth.is_none() {
        progress.warn(&format!(
            "disp of {} is relative: scale and shift of each frame are chosen by the bounds of its depth",
            path.display()
        ));
    }
    let train = images
        .iter()
        .zip(&poses)
        .enumerate()
        .map(|(i, (image, pose))| {
            let mut frame = frame(image, pose, i as f64, None)?;
            if let Some(file) = masks.as_ref().map(|masks| masks[i].clone()) {
                frame.mask = Some(mask(file));
            }
            if let Some(file) = disparity.as_ref().map(|maps| maps[i].clone()) {
                let (near, far) = (pose.near, pose.far);
                frame.depth = Some(FrameSource::new(move || {
                    depth_of_disparity(&file, near, far).map_err(|e| e.of_file(&file))
                }));
            }
            Ok(frame)
        });
    let train = train.collect::<Result<_, ReadError>>()?;
    let test = views(path, n)?.into_iter().map(|view| {
        let pose = &poses[view.camera];
        let file = inside.file(view.file)?;
        frame(&file, pose, view.time as f64, Some(view.camera as u32))
    });
    Ok(Listing {
        train,
        test: test.collect::<Result<_, _>>()?,
        time_frames: n,
        duration_s: fps.map(|fps| (n - 1) as f64 / fps),
        metric: false,
        tracks: None,
    })
}

/// Numbers per camera.
const WIDTH: usize = 17;
/// Largest array of poses: a hundred thousand cameras.
const MAX_POSE_BYTES: u64 = 16 << 20;
const HINT: &str = "make the file of poses again";

/// A row of `poses_bounds.npy`.
struct Pose {
    /// Of images of the full size.
    camera: Camera,
    /// Depth in view, scene units.
    near: f64,
    far: f64,
}

/// Reads `poses_bounds.npy`: one row per camera, at least one.
fn read_bounds(path: &Path) -> Result<Vec<Pose>, ReadError> {
    let array = Numbers::read(path, MAX_POSE_BYTES).at(path)?;
    if array.shape.len() != 2 || array.shape[0] == 0 || array.shape[1] != WIDTH {
        let what = format!(
            "an array of shape {:?}; [cameras, 17] was expected",
            array.shape
        );
        return Err(Fault::bad(what, HINT).at(path));
    }
    let rows = array.values.as_chunks::<WIDTH>().0.iter().enumerate();
    rows.map(|(i, row)| pose_of(row).map_err(|e| e.within(path, format!("camera {i}"))))
        .collect()
}

fn pose_of(row: &[f64; WIDTH]) -> Result<Pose, Fault> {
    let [down, right, back, place, [height, width, focal]] =
        [0, 1, 2, 3, 4].map(|j| [0, 1, 2].map(|i| row[5 * i + j]));
    let c2w = pose::of_rotation([0, 1, 2].map(|i| [right[i], down[i], -back[i]]), place)?;
    let side = |v: f64| (v.fract() == 0.0 && (1.0..=65536.0).contains(&v)).then_some(v as usize);
    let (Some(w), Some(h)) = (side(width), side(height)) else {
        return Err(Fault::bad(
            format!("images of {width} x {height} pixels"),
            HINT,
        ));
    };
    let intrinsics = Intrinsics::centred(w, h, focal);
    Lens::pinhole(intrinsics).check()?;
    let (near, far) = (row[15], row[16]);
    for (field, depth) in [("the nearest depth", near), ("the farthest depth", far)] {
        range::check(field, depth, &range::DEPTH, "scene units", HINT)?;
    }
    if far <= near {
        return Err(Fault::bad(
            format!("depth from {near} to {far}; near < far was expected"),
            HINT,
        ));
    }
    Ok(Pose {
        camera: Camera { intrinsics, c2w },
        near,
        far,
    })
}

/// The folder of images.
fn image_folder(path: &Path, options: &ImportOptions) -> Result<PathBuf, ReadError> {
    let named = match (&options.images, options.factor) {
        (Some(folder), _) => vec![folder.clone()],
        (None, Some(0 | 1)) => vec![path.join("images")],
        (None, Some(factor)) => vec![path.join(format!("images_{factor}"))],
        (None, None) => vec![path.join("images_2"), path.join("images")],
    };
    named.iter().find(|p| p.is_dir()).cloned().ok_or_else(|| {
        let what = named[0].display().to_string();
        Fault::missing(
            what,
            "choose a factor whose images exist (the option factor)",
        )
        .at(path)
    })
}

fn frame(
    image: &Path,
    pose: &Pose,
    t: f64,
    camera_index: Option<u32>,
) -> Result<ListedFrame, ReadError> {
    let StoredImage { size, rgb } = stored_image(image)?;
    let k = resized(&pose.camera.intrinsics, size).at(image)?;
    Ok(ListedFrame {
        camera_index,
        ..ListedFrame::new(stem(image), Lens::pinhole(k), pose.camera.c2w, t, rgb)
    })
}

/// Largest map of disparity in memory.
const MAX_BYTES: u64 = 512 << 20;
/// Quantiles that are put on the bounds: those that LLFF takes of the points.
const QUANTILES: [f64; 2] = [0.001, 0.999];
/// Depth ends at this many times `far`.
const FARTHEST: f64 = 4.0;

/// z-depth of a map `[h][w]` of disparity up to scale and shift.
fn depth_of_disparity(path: &Path, near: f64, far: f64) -> Result<CompactDepth, Fault> {
    let array = Numbers::read(path, MAX_BYTES)?;
    let (h, w) = array.map_size()?;
    let mut sorted: Vec<f64> = array
        .values
        .iter()
        .copied()
        .filter(|v| v.is_finite())
        .collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let [low, high] = QUANTILES.map(|q| quantile(&sorted, q));
    let differs = high > low;
    if !differs {
        let what = "its disparity is the same everywhere";
        return Err(Fault::bad(
            what,
            "give maps of a network, or leave the folder disp away",
        ));
    }
    let a = (1.0 / near - 1.0 / far) / (high - low);
    let b = 1.0 / far - a * low;
    let least = 1.0 / (FARTHEST * far);
    let map: DepthMap = Plane::from_fn(w, h, |x, y| {
        let disparity = a * array.values[y * w + x] + b;
        if disparity.is_finite() {
            depth_in_range((1.0 / disparity.max(least)) as f32)
        } else {
            0.0
        }
    });
    Ok(map.into())
}

/// Linear between the two nearest, NaN of nothing.
fn quantile(sorted: &[f64], q: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else {
        return f64::NAN;
    };
    let at = q * last as f64;
    let (i, part) = (at.floor() as usize, at.fract());
    sorted[i] * (1.0 - part) + sorted[(i + 1).min(last)] * part
}

struct HeldOutImage {
    file: PathBuf,
    camera: usize,
    time: usize,
}

/// All of them, none where there is no folder of such; `n` cameras and moments.
fn views(root: &Path, n: usize) -> Result<Vec<HeldOutImage>, ReadError> {
    let flat = ["gt", "test"].map(|name| root.join(name));
    if let Some(folder) = flat.iter().find(|p| p.is_dir()) {
        let files = listed(folder, EXTENSIONS)?;
        let views = files.into_iter().filter_map(|file| {
            let (camera, time) = by_name(&stem(&file))?;
            Some(checked(HeldOutImage { file, camera, time }, n))
        });
        return views.collect();
    }
    let folder = root.join("mv_images");
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let mut moments = Vec::new();
    for entry in std::fs::read_dir(&folder).at(&folder)? {
        let path = entry.at(&folder)?.path();
        if let (true, Ok(time)) = (path.is_dir(), stem(&path).parse::<usize>()) {
            moments.push((time, path));
        }
    }
    moments.sort();
    let mut views = Vec::new();
    for (time, moment) in moments {
        let files = listed(&moment, EXTENSIONS)?;
        // of the cameras around, in turn, one took the training image
        let cameras = files.len().max(1);
        for file in files {
            let number = stem(&file)
                .strip_prefix("cam")
                .and_then(|n| n.parse::<usize>().ok());
            let Some(camera) = number.and_then(|n| n.checked_sub(1)) else {
                let what = "its name is not camNN, the number of a camera from 1";
                return Err(Fault::bad(what, "name the views as NSFF does").at(&file));
            };
            if camera != time % cameras {
                views.push(checked(HeldOutImage { file, camera, time }, n)?);
            }
        }
    }
    Ok(views)
}

/// `vCCC_tTTT`.
fn by_name(name: &str) -> Option<(usize, usize)> {
    let (camera, time) = name.strip_prefix('v')?.split_once("_t")?;
    Some((camera.parse().ok()?, time.parse().ok()?))
}

fn checked(view: HeldOutImage, n: usize) -> Result<HeldOutImage, ReadError> {
    if view.camera < n && view.time < n {
        return Ok(view);
    }
    let what = format!(
        "camera {} at time {} where there are {n} cameras and moments",
        view.camera, view.time
    );
    Err(Fault::bad(what, "give views of the cameras in poses_bounds.npy").at(&view.file))
}
