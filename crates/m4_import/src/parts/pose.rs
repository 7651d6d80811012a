//! Matrices and quaternions to camera-to-world.

use crate::core::SourceFault;
use m4_io::capture::Pose;
use m4_math::Se3;
use m4_math::nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// How far the length of a quaternion may be from 1: what printing with few digits and an optimiser leave.
const UNIT_WITHIN: f64 = 1e-2;
const REMEDY: &str = "correct the pose in the source, or drop the frame";

/// The rigid motion of a matrix of 12 (3x4) or 16 (4x4) numbers, row by row; `name` is for messages.
pub(crate) fn of_matrix(name: &str, numbers: &[f64]) -> Result<Se3<f64>, SourceFault> {
    let rows: Vec<&[f64]> = numbers.chunks(4).collect();
    of_rows(name, &rows)
}

/// The rigid motion of the rows of a 3x4 or 4x4 matrix.
pub(crate) fn of_rows<R: AsRef<[f64]>>(name: &str, rows: &[R]) -> Result<Se3<f64>, SourceFault> {
    match Pose::from_rows(rows) {
        Ok(Pose(pose)) => Ok(pose),
        Err(fault) => Err(SourceFault::bad(format!("{name} {fault}"), REMEDY)),
    }
}

/// The rigid motion of a place and a quaternion `w x y z`.
pub(crate) fn of_quaternion(place: [f64; 3], [w, x, y, z]: [f64; 4]) -> Result<Se3<f64>, SourceFault> {
    if let Some(value) = place.iter().find(|v| !v.is_finite()) {
        return Err(SourceFault::bad(
            format!("the place of the camera holds {value}"),
            REMEDY,
        ));
    }
    let q = Quaternion::new(w, x, y, z);
    let length = q.norm();
    // also where it is not a number
    if (length - 1.0).abs().partial_cmp(&UNIT_WITHIN) != Some(std::cmp::Ordering::Less) {
        let what = format!("the quaternion of the camera has length {length:.4}; 1 was expected");
        return Err(SourceFault::bad(what, REMEDY));
    }
    Ok(Se3 {
        rotation: UnitQuaternion::new_normalize(q).to_rotation_matrix().into_inner(),
        translation: Vector3::from(place),
    })
}
