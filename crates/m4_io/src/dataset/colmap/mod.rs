//! COLMAP's sparse models, text and binary, of COLMAP itself and of the many tools that write the
//! same files.
//!
//! ```text
//! PATH/sparse/0, PATH/sparse or PATH   cameras, images, each .bin or .txt; rigs, frames and points3D are not needed
//! PATH/images, or options.images     the images by the names of `images` (which may begin with `images/`)
//!
//! files -> read_tables -> lenses, poses -> frames in the natural order of their names
//! ```
//!
//! **What is converted.** Poses are world to camera with a quaternion `w x y z` and OpenCV axes;
//! they are inverted. Principal points are measured from the image's corner, as ours. Lenses of
//! SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, FULL_OPENCV, SIMPLE_FISHEYE, FISHEYE,
//! SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE and OPENCV_FISHEYE are undistorted. A sparse model has no
//! clock: time is a frame's place among the images of its folder in the natural order of names, so
//! that images that COLMAP could not register leave a gap; where images lie in several folders
//! frames are evenly spaced. Its scale is arbitrary.
//!
//! [`write()`] writes a capture as such a folder.
//!
//! Source: COLMAP's documentation, "Output Format" and "Camera Models"; the rigs of 3.12 and later
//! leave `images` as it was.

mod parse;
mod tables;
mod write;

pub use tables::{ColmapCamera, ColmapImage, ColmapPoint, ColmapTables, read_points, read_tables};
pub use write::write;

use super::files::{Inside, duration_s, given_fps, stored_image};
use super::{Distortion, ImportOptions, Lens, ListedFrame, Listing};
use crate::error::AtPath;
use crate::files::{below, natural};
use crate::{Fault, ReadError};
use m4_core::{Intrinsics, Progress};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Whether there is a sparse model in or at `path`.
pub(super) fn detect(path: &Path) -> bool {
    model_folder(path).is_some()
}

fn model_folder(path: &Path) -> Option<PathBuf> {
    let folders = [
        path.join("sparse/0"),
        path.join("sparse"),
        path.join("0"),
        path.to_path_buf(),
    ];
    let is_model = |folder: &PathBuf| {
        ["bin", "txt"].iter().any(|e| {
            ["cameras", "images"]
                .iter()
                .all(|n| folder.join(format!("{n}.{e}")).is_file())
        })
    };
    folders.into_iter().find(is_model)
}

/// The folder that names start from: as the options say, else `images` beside the model or one or
/// two folders up, or one of these folders themselves (ViPE's script writes names with `images/`),
/// whichever has the first image. With it the folder that the model and its images are in.
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
    let has =
        |(folder, _): &(PathBuf, PathBuf)| below(folder, first).is_ok_and(|file| file.is_file());
    folders.into_iter().find(has).ok_or_else(|| {
        let what =
            format!("the image {first:?}, in a folder `images` beside the model or above it,");
        Fault::missing(what, "give the folder of the images (images)").at(model)
    })
}

pub(super) fn list(
    path: &Path,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Listing, ReadError> {
    given_fps(options).at(path)?;
    let folder = model_folder(path).ok_or_else(|| {
        let hint = "a folder with cameras and images, both .bin or both .txt, or one with sparse/0 is needed";
        Fault::missing("a sparse model", hint).at(path)
    })?;
    if path.join("sparse/1").is_dir() && folder.ends_with("sparse/0") {
        progress.warn("there are several sparse models; the first (sparse/0) is read");
    }
    let ColmapTables {
        cameras,
        mut images,
    } = read_tables(&folder)?;
    let mut lenses = HashMap::new();
    for camera in &cameras {
        let k = lens_of(camera).map_err(|e| e.within(&folder, format!("camera {}", camera.id)))?;
        lenses.entry(camera.id).or_insert(k);
    }
    images.sort_by(|a, b| natural(&a.name, &b.name));
    let (images_in, root) = image_folder(&folder, &images, options)?;
    let inside = Inside::of(&root, options);
    let places = places(&images_in, &images);
    let mut train = Vec::with_capacity(images.len());
    for (i, image) in images.iter().enumerate() {
        let at =
            |cause: Fault| cause.within(&folder, format!("image {} ({:?})", image.id, image.name));
        let lens = lenses.get(&image.camera).ok_or_else(|| {
            let what = format!(
                "it was taken by camera {}, which is not there",
                image.camera
            );
            at(Fault::bad(what, "export the model again"))
        })?;
        let c2w = image.c2w().map_err(at)?;
        let file = below(&images_in, &image.name).map_err(at)?;
        let file = inside.check(file).map_err(at)?;
        let stored = stored_image(&file).map_err(|e| at(e.into()))?;
        lens.check_size(stored.size).map_err(at)?;
        let t = places.as_ref().map_or(i as f64, |(of, _)| of[i] as f64);
        train.push(ListedFrame::new(
            image.name.clone(),
            *lens,
            c2w,
            t,
            stored.rgb,
        ));
    }
    let time_frames = places.map_or(train.len(), |(_, all)| all);
    let duration_s = duration_s(time_frames, options, progress);
    Ok(Listing::of_video(train, time_frames, duration_s))
}

/// The places of the images among all images of their folder, and how many these are; `None` where
/// they lie in several.
fn places(folder: &Path, images: &[ColmapImage]) -> Option<(Vec<usize>, usize)> {
    let inner = Path::new(&images.first()?.name).parent()?;
    let files = crate::video::image_files(&folder.join(inner)).ok()?;
    let name = |file: &PathBuf| Some(inner.join(file.file_name()?));
    let index: HashMap<PathBuf, usize> = files
        .iter()
        .enumerate()
        .filter_map(|(i, f)| Some((name(f)?, i)))
        .collect();
    let of: Option<Vec<usize>> = images
        .iter()
        .map(|image| index.get(Path::new(&image.name)).copied())
        .collect();
    Some((of?, files.len()))
}

/// Longest side of an image, pixels.
const MAX_SIDE: u64 = 1 << 16;

/// The lens of a camera.
fn lens_of(camera: &ColmapCamera) -> Result<Lens, Fault> {
    let fisheye = |k: [f64; 4]| Distortion::Fisheye { k };
    let radial = |k1, k2| Distortion::brown(k1, k2, 0.0, 0.0, 0.0);
    let ([fx, fy, cx, cy], distortion) = match (camera.model.as_str(), camera.parameters.as_slice())
    {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => ([f, f, cx, cy], Distortion::None),
        ("PINHOLE", &[fx, fy, cx, cy]) => ([fx, fy, cx, cy], Distortion::None),
        ("SIMPLE_RADIAL", &[f, cx, cy, k]) => ([f, f, cx, cy], radial(k, 0.0)),
        ("RADIAL", &[f, cx, cy, k1, k2]) => ([f, f, cx, cy], radial(k1, k2)),
        ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
            ([fx, fy, cx, cy], Distortion::brown(k1, k2, 0.0, p1, p2))
        }
        ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
            let full = Distortion::Brown {
                radial: [k1, k2, k3, k4, k5, k6],
                tangential: [p1, p2],
            };
            let none = [k1, k2, p1, p2, k3, k4, k5, k6] == [0.0; 8];
            ([fx, fy, cx, cy], if none { Distortion::None } else { full })
        }
        ("SIMPLE_FISHEYE", &[f, cx, cy]) => ([f, f, cx, cy], fisheye([0.0; 4])),
        ("FISHEYE", &[fx, fy, cx, cy]) => ([fx, fy, cx, cy], fisheye([0.0; 4])),
        ("SIMPLE_RADIAL_FISHEYE", &[f, cx, cy, k]) => ([f, f, cx, cy], fisheye([k, 0.0, 0.0, 0.0])),
        ("RADIAL_FISHEYE", &[f, cx, cy, k1, k2]) => ([f, f, cx, cy], fisheye([k1, k2, 0.0, 0.0])),
        ("OPENCV_FISHEYE", &[fx, fy, cx, cy, k1, k2, k3, k4]) => {
            ([fx, fy, cx, cy], fisheye([k1, k2, k3, k4]))
        }
        (model, parameters) => {
            let what = format!(
                "its lens is of the model {model} with {} parameters",
                parameters.len()
            );
            let hint = "models of pinholes, RADIAL, OPENCV and their fisheyes are read; undistort the images \
                          (`colmap image_undistorter`)";
            return Err(Fault::unsupported(what, hint));
        }
    };
    let side = |px: u64| (1..=MAX_SIDE).contains(&px);
    if !(side(camera.width) && side(camera.height)) {
        let what = format!("its images are {} x {} pixels", camera.width, camera.height);
        return Err(Fault::bad(what, "export the model again"));
    }
    let lens = Lens {
        intrinsics: Intrinsics {
            width: camera.width as usize,
            height: camera.height as usize,
            fx,
            fy,
            cx,
            cy,
        },
        distortion,
    };
    lens.check()?;
    Ok(lens)
}

#[cfg(test)]
mod tests {
    use super::{ColmapCamera, lens_of};
    use crate::dataset::Distortion;
    use serde::Deserialize;

    #[derive(Deserialize)]
    struct Fixture {
        points: Vec<[f64; 2]>,
        models: Vec<Case>,
        opencv: Vec<[f64; 2]>,
        opencv_fisheye: Vec<[f64; 2]>,
    }

    #[derive(Deserialize)]
    struct Case {
        model: String,
        parameters: Vec<f64>,
        pixels: Vec<[f64; 2]>,
    }

    #[test]
    fn lens_models_match_pycolmap_and_opencv() {
        let path = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../fixtures/import/clip/lenses.json"
        );
        let fixture: Fixture = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
        assert_eq!(fixture.models.len(), 11);
        for case in &fixture.models {
            let camera = ColmapCamera {
                id: 1,
                model: case.model.clone(),
                width: 48,
                height: 36,
                parameters: case.parameters.clone(),
            };
            let lens = lens_of(&camera).unwrap();
            let pinhole = ["SIMPLE_PINHOLE", "PINHOLE"].contains(&case.model.as_str());
            assert_eq!(
                lens.distortion == Distortion::None,
                pinhole,
                "{}",
                case.model
            );
            let by_opencv = match case.model.as_str() {
                "OPENCV" => Some(&fixture.opencv),
                "OPENCV_FISHEYE" => Some(&fixture.opencv_fisheye),
                _ => None,
            };
            assert_eq!(case.pixels.len(), fixture.points.len());
            for pixels in [Some(&case.pixels), by_opencv].into_iter().flatten() {
                for ([x, y], [u, v]) in fixture.points.iter().zip(pixels) {
                    let [a, b] = lens.distortion.distorted(*x, *y);
                    let k = lens.intrinsics;
                    let off = (k.fx * a + k.cx - u).abs().max((k.fy * b + k.cy - v).abs());
                    assert!(off < 1e-9, "{} at ({x}, {y}): {off:e}", case.model);
                }
            }
        }
    }

    #[test]
    fn other_models_and_sizes_are_refused() {
        let camera = |model: &str, width, parameters: &[f64]| ColmapCamera {
            id: 1,
            model: model.into(),
            width,
            height: 36,
            parameters: parameters.to_vec(),
        };
        let refused = |c: &ColmapCamera| lens_of(c).unwrap_err().to_string();
        assert!(refused(&camera("FOV", 48, &[50.0, 50.0, 24.0, 18.0, 0.9])).contains("FOV"));
        assert!(refused(&camera("PINHOLE", 48, &[50.0, 24.0, 18.0])).contains("3 parameters"));
        assert!(
            refused(&camera("PINHOLE", 1 << 40, &[50.0, 50.0, 24.0, 18.0]))
                .contains("1099511627776 x 36")
        );
        assert!(refused(&camera("PINHOLE", 48, &[50.0, f64::NAN, 24.0, 18.0])).contains("NaN"));
    }
}
