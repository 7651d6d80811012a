//! What the three files hold, between bytes and scene.

use m4_math::Se3;
use m4_math::nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use m4_scene::{Camera, Intrinsics};

/// A picture of a sparse model.
#[derive(Debug, Clone, PartialEq)]
pub struct ColmapImage {
    /// File name, relative to the folder of pictures.
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

/// A line of `cameras`.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraRow {
    pub id: u32,
    pub lens: Intrinsics,
}

/// A line of `images`.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageRow {
    pub id: u32,
    /// `(w, x, y, z)`, world to camera.
    pub rotation: [f64; 4],
    pub translation: [f64; 3],
    pub camera: u32,
    pub name: String,
}

/// The three files.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tables {
    pub cameras: Vec<CameraRow>,
    pub images: Vec<ImageRow>,
    pub points: Vec<ColmapPoint>,
}

impl Tables {
    /// Tables of cameras: equal lenses become one camera, identifiers count from 1.
    pub fn new(cameras: &[Camera], names: Vec<String>, points: Vec<ColmapPoint>) -> Self {
        let mut lenses: Vec<CameraRow> = Vec::new();
        let mut images = Vec::with_capacity(cameras.len());
        for (i, (camera, name)) in cameras.iter().zip(names).enumerate() {
            let lens = camera.intrinsics;
            let known = lenses.iter().find(|row| row.lens == lens).map(|row| row.id);
            let id = known.unwrap_or_else(|| {
                let id = lenses.len() as u32 + 1;
                lenses.push(CameraRow { id, lens });
                id
            });
            let w2c = camera.w2c();
            let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(w2c.rotation));
            images.push(ImageRow {
                id: i as u32 + 1,
                rotation: [q.w, q.i, q.j, q.k],
                translation: w2c.translation.into(),
                camera: id,
                name,
            });
        }
        Self {
            cameras: lenses,
            images,
            points,
        }
    }

    /// The model; what is wrong with the tables where they are none.
    pub fn into_model(mut self) -> Result<ColmapModel, String> {
        self.images.sort_by_key(|row| row.id);
        let mut images = Vec::with_capacity(self.images.len());
        for row in self.images {
            let lens = self.cameras.iter().find(|c| c.id == row.camera);
            let lens = lens.ok_or_else(|| {
                format!(
                    "image {} ({:?}) was taken by camera {}, which is not there",
                    row.id, row.name, row.camera
                )
            })?;
            let w2c = pose(&row).ok_or_else(|| {
                format!(
                    "image {} ({:?}) has the pose {:?} {:?}; a rotation and a place were expected",
                    row.id, row.name, row.rotation, row.translation
                )
            })?;
            images.push(ColmapImage {
                name: row.name,
                camera: Camera {
                    intrinsics: lens.lens,
                    c2w: w2c.inverse(),
                },
            });
        }
        if let Some((i, p)) = (self.points.iter().enumerate()).find(|(_, p)| !p.position.iter().all(|v| v.is_finite()))
        {
            return Err(format!("point {i} lies at {:?}", p.position));
        }
        Ok(ColmapModel {
            images,
            points: self.points,
        })
    }
}

/// World to camera; `None` where the numbers are no pose.
fn pose(row: &ImageRow) -> Option<Se3<f64>> {
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
pub fn lens(model: &str, width: u64, height: u64, parameters: &[f64]) -> Result<Intrinsics, String> {
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
