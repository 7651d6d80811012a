//! COLMAP's sparse models, text and binary, of COLMAP itself and of the many tools that write the same files.
//!
//! ```text
//! PATH/sparse/0, PATH/sparse or PATH   cameras, images, each .bin or .txt; rigs, frames and points3D are not needed
//! PATH/images, or options.images     the images by the names of `images` (which may begin with `images/`)
//!
//! files -> read_tables -> lenses, poses -> frames in the natural order of their names
//! ```
//!
//! **What is converted.** Poses are world to camera with a quaternion `w x y z` and OpenCV axes; they are inverted. Principal
//! points are measured from the image's corner, as ours. Lenses of SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV,
//! FULL_OPENCV, SIMPLE_FISHEYE, FISHEYE, SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE and OPENCV_FISHEYE are undistorted. A sparse
//! model has no clock: time is a frame's place among the images of its folder in the natural order of names, so that images that
//! COLMAP could not register leave a gap; where images lie in several folders frames are evenly spaced. Its scale is arbitrary.
//!
//! [`write()`] writes a capture as such a folder.
//!
//! Source: COLMAP's documentation, "Output Format" and "Camera Models"; the rigs of 3.12 and later leave `images` as it was.

mod binary;
mod lens;
mod tables;
mod text;
mod write;

use crate::dataset::files::{Inside, clock, images};
use crate::dataset::{ImportOptions, ListedFrame, Listing};
use crate::error::AtPath;
use crate::files::below;
use crate::files::natural;
use crate::{Fault, ReadError};
use m4_core::Progress;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
pub use tables::{ColmapCamera, ColmapImage, ColmapPoint, ColmapTables, read_points, read_tables};
pub use write::write;

/// Whether there is a sparse model in or at `path`.
pub(super) fn detect(path: &Path) -> bool {
    model_folder(path).is_some()
}

fn model_folder(path: &Path) -> Option<PathBuf> {
    let folders = [path.join("sparse/0"), path.join("sparse"), path.join("0"), path.to_path_buf()];
    let is_model = |folder: &PathBuf| {
        ["bin", "txt"].iter().any(|e| ["cameras", "images"].iter().all(|n| folder.join(format!("{n}.{e}")).is_file()))
    };
    folders.into_iter().find(is_model)
}

/// The folder that names start from: as the options say, else `images` beside the model or one or two folders up, or one of these
/// folders themselves (ViPE's script writes names with `images/`), whichever has the first image. With it the folder that the model
/// and its images are in.
fn image_folder(
    model: &Path,
    images: &[ColmapImage],
    options: &ImportOptions,
) -> Result<(PathBuf, PathBuf), ReadError> {
    if let Some(folder) = &options.images {
        return Ok((folder.clone(), model.to_path_buf()));
    }
    let first = images.first().map_or("", |image| image.name.as_str());
    let up = || model.ancestors().take(3);
    let folders = up()
        .map(|folder| (folder.join("images"), folder.to_path_buf()))
        .chain(up().map(|folder| (folder.to_path_buf(), folder.to_path_buf())));
    let has = |(folder, _): &(PathBuf, PathBuf)| below(folder, first).is_ok_and(|file| file.is_file());
    folders.into_iter().find(has).ok_or_else(|| {
        let what = format!("the image {first:?}, in a folder `images` beside the model or above it,");
        Fault::missing(what, "give the folder of the images (images)").at(model)
    })
}

pub(super) fn list(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Listing, ReadError> {
    clock::fps(options).at(path)?;
    let folder = model_folder(path).ok_or_else(|| {
        let hint = "a folder with cameras and images, both .bin or both .txt, or one with sparse/0 is needed";
        Fault::missing("a sparse model", hint).at(path)
    })?;
    if path.join("sparse/1").is_dir() && folder.ends_with("sparse/0") {
        progress.warn("there are several sparse models; the first (sparse/0) is read");
    }
    let ColmapTables { cameras, mut images } = read_tables(&folder)?;
    let mut lenses = HashMap::new();
    for camera in &cameras {
        let k = lens::of(camera).map_err(|e| e.within(&folder, format!("camera {}", camera.id)))?;
        lenses.entry(camera.id).or_insert(k);
    }
    images.sort_by(|a, b| natural(&a.name, &b.name));
    let (images_in, root) = image_folder(&folder, &images, options)?;
    let inside = Inside::of(&root, options);
    let places = places(&images_in, &images);
    let mut train = Vec::with_capacity(images.len());
    for (i, image) in images.iter().enumerate() {
        let at = |cause: Fault| cause.within(&folder, format!("image {} ({:?})", image.id, image.name));
        let lens = lenses.get(&image.camera).ok_or_else(|| {
            let what = format!("it was taken by camera {}, which is not there", image.camera);
            at(Fault::bad(what, "export the model again"))
        })?;
        let c2w = image.c2w().map_err(at)?;
        let file = below(&images_in, &image.name).map_err(at)?;
        let file = inside.check(file).map_err(at)?;
        let stored = images::of_file(&file).map_err(|e| at(e.into()))?;
        lens.check_size(stored.size).map_err(at)?;
        let t = places.as_ref().map_or(i as f64, |places| places.of[i] as f64);
        train.push(ListedFrame::new(image.name.clone(), *lens, c2w, t, stored.rgb));
    }
    let time_frames = places.map_or(train.len(), |places| places.all);
    let duration_s = clock::duration_s(time_frames, options, progress);
    Ok(Listing::of_video(train, time_frames, duration_s))
}

/// Where frames are in the folder that they were taken from.
struct Places {
    of: Vec<usize>,
    all: usize,
}

/// The places of the images among all images of their folder; `None` where they lie in several.
fn places(folder: &Path, images: &[ColmapImage]) -> Option<Places> {
    let inner = Path::new(&images.first()?.name).parent()?;
    let files = crate::video::image_files(&folder.join(inner)).ok()?;
    let name = |file: &PathBuf| Some(inner.join(file.file_name()?));
    let index: HashMap<PathBuf, usize> = files.iter().enumerate().filter_map(|(i, f)| Some((name(f)?, i))).collect();
    let of: Option<Vec<usize>> = images.iter().map(|image| index.get(Path::new(&image.name)).copied()).collect();
    Some(Places { of: of?, all: files.len() })
}
