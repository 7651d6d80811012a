//! NVIDIA Dynamic Scenes, and any clip in the layout of LLFF: `poses_bounds.npy` beside folders of images.
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
//! Columns of the rotation are the camera's down, right and back in the world; in our axes (right, down, forward) they are
//! columns 1, 0 and minus 2. The principal point is the middle. Images may be of any size; height, width and focal length shrink with
//! them. Disparity of the network is known up to scale and shift: both are chosen for each frame so that its 0.1 and 99.9 percent
//! quantiles are those of the bounds, which is how COLMAP's points made these (`imgs2poses.py` of Fyusion/LLFF); this is said through
//! `progress`. Sources: `load_llff.py` of zhengqili/Neural-Scene-Flow-Fields, `dataLoader/nvidia.py` of facebookresearch/robust-dynrf.
//!
//! `v000_t000` is the view of the first training image: results compare only if both or neither count it.

mod disparity;
mod views;

use crate::dataset::files::images::{StoredImage, of_file};
use crate::dataset::files::{Inside, clock, lens, listed, stem};
use crate::dataset::llff::{self, Pose};
use crate::dataset::side::mask::read_mask;
use crate::dataset::{FrameSource, ImportOptions, Lens, ListedFrame, Listing, ReadSourceError, SourceErrorCause};
use m4_core::Progress;
use std::path::{Path, PathBuf};

const EXTENSIONS: &[&str] = &["png", "jpg", "jpeg"];

/// Detects a folder of the format.
pub(crate) fn detect(path: &Path) -> bool {
    path.join("poses_bounds.npy").is_file() && (path.join("images").is_dir() || path.join("images_2").is_dir())
}

pub(crate) fn list(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Listing, ReadSourceError> {
    let poses = llff::read_bounds(&path.join("poses_bounds.npy"))?;
    let n = poses.len();
    let fps = clock::fps(options).map_err(|e| e.at(path))?;
    let folder = image_folder(path, options)?;
    let inside = Inside::of(path, options);
    let images = inside.files(as_many(&folder, EXTENSIONS, "images", n)?)?;
    let optional = |name: &str, extensions: &[&str], what: &str| -> Result<Option<Vec<PathBuf>>, ReadSourceError> {
        let folder = path.join(name);
        let listed = || inside.files(as_many(&folder, extensions, what, n)?);
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
    let train = images.iter().zip(&poses).enumerate().map(|(i, (image, pose))| {
        let mut frame = frame(image, pose, i as f64, None)?;
        if let Some(file) = masks.as_ref().map(|masks| masks[i].clone()) {
            frame.mask = Some(FrameSource::new(move || {
                Ok(read_mask(&file, false).map_err(|e| e.of_file(&file))?.mask)
            }));
        }
        if let Some(file) = disparity.as_ref().map(|maps| maps[i].clone()) {
            let (near, far) = (pose.near, pose.far);
            frame.depth = Some(FrameSource::new(move || {
                disparity::depth(&file, near, far).map_err(|e| e.of_file(&file))
            }));
        }
        Ok(frame)
    });
    let train = train.collect::<Result<_, ReadSourceError>>()?;
    let test = views::read(path, n)?.into_iter().map(|view| {
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

/// The folder of images.
fn image_folder(path: &Path, options: &ImportOptions) -> Result<PathBuf, ReadSourceError> {
    let named = match (&options.images, options.factor) {
        (Some(folder), _) => vec![folder.clone()],
        (None, Some(0 | 1)) => vec![path.join("images")],
        (None, Some(factor)) => vec![path.join(format!("images_{factor}"))],
        (None, None) => vec![path.join("images_2"), path.join("images")],
    };
    named.iter().find(|p| p.is_dir()).cloned().ok_or_else(|| {
        let what = named[0].display().to_string();
        SourceErrorCause::missing(what, "choose a factor whose images exist (the option factor)").at(path)
    })
}

fn as_many(folder: &Path, extensions: &[&str], what: &str, n: usize) -> Result<Vec<PathBuf>, ReadSourceError> {
    let files = listed(folder, extensions)?;
    if files.len() == n {
        return Ok(files);
    }
    let what = format!("{} {what} for {n} poses of poses_bounds.npy", files.len());
    Err(SourceErrorCause::bad(what, "give one for each pose").at(folder))
}

fn frame(image: &Path, pose: &Pose, t: f64, camera_index: Option<u32>) -> Result<ListedFrame, ReadSourceError> {
    let StoredImage { size, rgb, .. } = of_file(image).map_err(|e| e.at(image))?;
    let k = lens::resized(&pose.camera.intrinsics, size).map_err(|e| e.at(image))?;
    Ok(ListedFrame {
        camera_index,
        ..ListedFrame::new(stem(image), Lens::pinhole(k), pose.camera.c2w, t, rgb)
    })
}
