//! The contents of the three files, between bytes and scene.

use m4_core::{
    Camera, Intrinsics, Se3,
    nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3},
};
use std::collections::HashMap;

/// Models without distortion.
const PINHOLES: [&str; 2] = ["SIMPLE_PINHOLE", "PINHOLE"];

/// An image of a sparse model.
#[derive(Debug, Clone, PartialEq)]
pub struct ColmapImage {
    /// File name, relative to the folder of images.
    pub name: String,
    /// Lens and pose, in our conventions.
    pub camera: Camera,
}

/// A point of a sparse model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColmapPoint {
    /// World units.
    pub position: [f64; 3],
    /// sRGB.
    pub colour: [u8; 3],
}

/// A sparse model.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ColmapModel {
    /// In the order of their identifiers.
    pub images: Vec<ColmapImage>,
    /// In the order of the file.
    pub points: Vec<ColmapPoint>,
}

/// A line of `cameras`: a lens of any of COLMAP's models, as the file has it.
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
    /// Focal lengths and principal point in pixels (from the image's corner), then distortion, in the order of the model.
    pub parameters: Vec<f64>,
}

impl ColmapCamera {
    /// A pinhole.
    pub(super) fn pinhole(id: u32, lens: &Intrinsics) -> Self {
        Self {
            id,
            model: "PINHOLE".into(),
            width: lens.width as u64,
            height: lens.height as u64,
            parameters: vec![lens.fx, lens.fy, lens.cx, lens.cy],
        }
    }
}

/// A line of `images`: an image with its pose, as the file has it.
#[derive(Debug, Clone, PartialEq)]
pub struct ColmapPose {
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

impl ColmapPose {
    /// Camera to world, OpenCV axes; what is wrong with the numbers where they are no pose.
    ///
    /// # Errors
    ///
    /// The image and its numbers.
    pub fn c2w(&self) -> Result<Se3<f64>, String> {
        let w2c = pose(self).ok_or_else(|| {
            format!(
                "image {} ({:?}) has the pose {:?} {:?}; a rotation and a place were expected",
                self.id, self.name, self.rotation, self.translation
            )
        })?;
        Ok(w2c.inverse())
    }
}

/// The cameras and poses of a sparse model, as the files have them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ColmapTables {
    /// In the order of the file.
    pub cameras: Vec<ColmapCamera>,
    /// In the order of the file.
    pub images: Vec<ColmapPose>,
}

/// The three files.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tables {
    pub cameras: Vec<ColmapCamera>,
    pub images: Vec<ColmapPose>,
    pub points: Vec<ColmapPoint>,
}

/// Why tables are no model of pinholes.
pub enum ModelFault {
    /// A lens that is none.
    Camera(u32, String),
    /// A lens of another model.
    Unsupported(String),
    /// The files contradict each other.
    Inconsistent(String),
}

impl Tables {
    /// Tables of cameras: equal lenses become one camera, identifiers count from 1.
    pub fn new(cameras: &[Camera], names: Vec<String>, points: Vec<ColmapPoint>) -> Self {
        let mut lenses: Vec<Intrinsics> = Vec::new();
        let mut images = Vec::with_capacity(cameras.len());
        for (i, (camera, name)) in cameras.iter().zip(names).enumerate() {
            let lens = camera.intrinsics;
            let known = lenses.iter().position(|k| *k == lens);
            let id = known.unwrap_or_else(|| {
                lenses.push(lens);
                lenses.len() - 1
            }) as u32
                + 1;
            let w2c = camera.w2c();
            let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(w2c.rotation));
            images.push(ColmapPose {
                id: i as u32 + 1,
                rotation: [q.w, q.i, q.j, q.k],
                translation: w2c.translation.into(),
                camera: id,
                name,
            });
        }
        Self {
            cameras: (1..)
                .zip(&lenses)
                .map(|(id, lens)| ColmapCamera::pinhole(id, lens))
                .collect(),
            images,
            points,
        }
    }

    /// The model, all of pinholes; what is wrong with the tables where they are none.
    pub fn into_model(mut self) -> Result<ColmapModel, ModelFault> {
        self.images.sort_by_key(|row| row.id);
        let mut lenses = HashMap::new();
        for camera in &self.cameras {
            if !PINHOLES.contains(&camera.model.as_str()) {
                return Err(ModelFault::Unsupported(format!("model {}", camera.model)));
            }
            let k = lens(&camera.model, camera.width, camera.height, &camera.parameters);
            let k = k.map_err(|reason| ModelFault::Camera(camera.id, reason))?;
            lenses.entry(camera.id).or_insert(k);
        }
        let mut images = Vec::with_capacity(self.images.len());
        for row in self.images {
            let lens = lenses.get(&row.camera).ok_or_else(|| {
                ModelFault::Inconsistent(format!(
                    "image {} ({:?}) was taken by camera {}, which is not there",
                    row.id, row.name, row.camera
                ))
            })?;
            let c2w = row.c2w().map_err(ModelFault::Inconsistent)?;
            images.push(ColmapImage {
                name: row.name,
                camera: Camera { intrinsics: *lens, c2w },
            });
        }
        if let Some((i, p)) = (self.points.iter().enumerate()).find(|(_, p)| !p.position.iter().all(|v| v.is_finite()))
        {
            return Err(ModelFault::Inconsistent(format!("point {i} lies at {:?}", p.position)));
        }
        Ok(ColmapModel {
            images,
            points: self.points,
        })
    }
}

/// World to camera; `None` where the numbers are no pose.
fn pose(row: &ColmapPose) -> Option<Se3<f64>> {
    let [w, x, y, z] = row.rotation;
    let q = Quaternion::new(w, x, y, z);
    let numbers = row.translation.iter().all(|v| v.is_finite());
    if !(numbers && q.norm().is_finite() && q.norm() > 1e-9) {
        return None;
    }
    let rotation: Matrix3<f64> = UnitQuaternion::new_normalize(q).to_rotation_matrix().into_inner();
    Some(Se3 {
        rotation,
        translation: Vector3::from(row.translation),
    })
}

/// Parameters of the models that are read, as many as the file has; what is wrong with them.
fn lens(model: &str, width: u64, height: u64, parameters: &[f64]) -> Result<Intrinsics, String> {
    let (fx, fy, cx, cy) = match (model, parameters) {
        ("PINHOLE", &[fx, fy, cx, cy]) => (fx, fy, cx, cy),
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => (f, f, cx, cy),
        _ => return Err(format!("{model} with {} parameters", parameters.len())),
    };
    let side = |px: u64| (1..=1 << 16).contains(&px);
    let focal = |px: f64| px.is_finite() && px > 0.0;
    if !(side(width) && side(height) && focal(fx) && focal(fy) && cx.is_finite() && cy.is_finite()) {
        return Err(format!("{width} x {height} pixels with parameters {parameters:?}"));
    }
    Ok(Intrinsics {
        width: width as usize,
        height: height as usize,
        fx,
        fy,
        cx,
        cy,
    })
}
