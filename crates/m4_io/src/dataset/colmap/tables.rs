//! The contents of the files, between bytes and cameras.

use super::parse;
use crate::error::AtPath;
use crate::files;
use crate::{Fault, ReadError, WriteError};
use m4_core::nalgebra::{Quaternion, Rotation3, UnitQuaternion, Vector3};
use m4_core::{Camera, Intrinsics, Se3};
use std::fs;
use std::path::Path;

const HINT: &str = "export the model again";

/// The place of a fault in a file, and the fault.
pub(super) type PlacedError = (String, Fault);

pub(super) fn damaged(place: String, reason: String) -> PlacedError {
    (place, Fault::bad(reason, HINT))
}

/// A row of `cameras`: a lens of any of COLMAP's models, as the file has it.
#[derive(Debug, Clone, PartialEq)]
pub struct ColmapCamera {
    /// Identifier that images refer to.
    pub id: u32,
    /// COLMAP's name of the model, such as `OPENCV`.
    pub model: String,
    /// Columns of the images.
    pub width: u64,
    /// Rows of the images.
    pub height: u64,
    /// Focal lengths and principal point in pixels (from the image's corner), then distortion, in
    /// the order of the model.
    pub parameters: Vec<f64>,
}

/// A row of `images`: an image with its pose, as the file has it.
#[derive(Debug, Clone, PartialEq)]
pub struct ColmapImage {
    /// Identifier of the image.
    pub id: u32,
    /// `(w, x, y, z)`, world to camera, OpenCV axes.
    pub rotation: [f64; 4],
    /// World to camera.
    pub translation: [f64; 3],
    /// Identifier of its camera.
    pub camera: u32,
    /// File name, relative to the folder of images.
    pub name: String,
}

impl ColmapImage {
    /// Camera to world, OpenCV axes.
    pub(super) fn c2w(&self) -> Result<Se3<f64>, Fault> {
        let [w, x, y, z] = self.rotation;
        let q = Quaternion::new(w, x, y, z);
        let numbers = self.translation.iter().all(|v| v.is_finite());
        if !(numbers && q.norm().is_finite() && q.norm() > 1e-9) {
            let what = format!(
                "the pose is {:?} {:?}; a rotation and a place were expected",
                self.rotation, self.translation
            );
            return Err(Fault::bad(what, HINT));
        }
        let w2c = Se3 {
            rotation: UnitQuaternion::new_normalize(q)
                .to_rotation_matrix()
                .into_inner(),
            translation: Vector3::from(self.translation),
        };
        Ok(w2c.inverse())
    }
}

/// A row of `points3D`, without what it was seen by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColmapPoint {
    /// World units.
    pub position: [f64; 3],
    /// sRGB.
    pub colour: [u8; 3],
}

/// The cameras and poses of a sparse model, as the files have them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ColmapTables {
    /// In the order of the file.
    pub cameras: Vec<ColmapCamera>,
    /// In the order of the file.
    pub images: Vec<ColmapImage>,
}

impl ColmapTables {
    /// Tables of pinholes: equal lenses become one camera, identifiers count from 1.
    pub(super) fn new(cameras: &[Camera], names: impl Iterator<Item = String>) -> Self {
        let mut lenses: Vec<Intrinsics> = Vec::new();
        let image = |((i, camera), name): ((u32, &Camera), String)| {
            let lens = camera.intrinsics;
            let index = lenses.iter().position(|k| *k == lens);
            let index = index.unwrap_or_else(|| {
                lenses.push(lens);
                lenses.len() - 1
            });
            let w2c = camera.w2c();
            let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(
                w2c.rotation,
            ));
            ColmapImage {
                id: i,
                rotation: [q.w, q.i, q.j, q.k],
                translation: w2c.translation.into(),
                camera: index as u32 + 1,
                name,
            }
        };
        let images = (1..).zip(cameras).zip(names).map(image).collect();
        let pinhole = |(id, lens): (u32, &Intrinsics)| ColmapCamera {
            id,
            model: "PINHOLE".into(),
            width: lens.width as u64,
            height: lens.height as u64,
            parameters: vec![lens.fx, lens.fy, lens.cx, lens.cy],
        };
        let cameras = (1..).zip(&lenses).map(pinhole).collect();
        Self { cameras, images }
    }
}

/// Reads `cameras` and `images` of a folder as they are, lenses of every model: the binary files
/// where they are, else the text.
pub fn read_tables(folder: &Path) -> Result<ColmapTables, ReadError> {
    Ok(if folder.join("cameras.bin").exists() {
        ColmapTables {
            cameras: parse(&folder.join("cameras.bin"), parse::read_cameras)?,
            images: parse(&folder.join("images.bin"), parse::read_images)?,
        }
    } else {
        ColmapTables {
            cameras: parse(&folder.join("cameras.txt"), utf8(parse::read_cameras_text))?,
            images: parse(&folder.join("images.txt"), utf8(parse::read_images_text))?,
        }
    })
}

/// Reads `points3D.bin`.
pub fn read_points(folder: &Path) -> Result<Vec<ColmapPoint>, ReadError> {
    parse(&folder.join("points3D.bin"), parse::read_points)
}

fn utf8<T>(
    parse: impl Fn(&str) -> Result<T, PlacedError>,
) -> impl Fn(&[u8]) -> Result<T, PlacedError> {
    move |bytes| parse(files::utf8(bytes).map_err(|(at, fault)| (format!("byte {at}"), fault))?)
}

fn parse<T>(path: &Path, parse: impl Fn(&[u8]) -> Result<T, PlacedError>) -> Result<T, ReadError> {
    let bytes = files::read(path, u64::MAX).at(path)?;
    parse(&bytes).map_err(|(place, cause)| cause.within(path, place))
}

/// Writes the three binary files and reads them back.
pub(super) fn write_model(
    folder: &Path,
    tables: &ColmapTables,
    points: &[ColmapPoint],
) -> Result<(), WriteError> {
    fs::create_dir_all(folder).map_err(|e| WriteError::io(folder, e))?;
    for (name, bytes) in [
        ("cameras.bin", parse::cameras(&tables.cameras)),
        ("images.bin", parse::images(&tables.images)),
        ("points3D.bin", parse::points(points)),
    ] {
        let path = folder.join(name);
        fs::write(&path, bytes).map_err(|e| WriteError::io(&path, e))?;
    }
    let verify = |reason: String| WriteError::verify(folder, reason);
    let back = read_tables(folder).and_then(|tables| Ok((tables, read_points(folder)?)));
    let (read, read_points) = back.map_err(|e| verify(e.to_string()))?;
    if read != *tables || read_points != points {
        return Err(verify("a camera, pose or point differs".into()));
    }
    Ok(())
}
