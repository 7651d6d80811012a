//! Converts matrices and quaternions to camera-to-world poses.

use crate::capture::Pose;
use crate::dataset::SourceErrorCause;
use m4_core::{
    Se3,
    nalgebra::{Quaternion, UnitQuaternion, Vector3},
};

/// How far the length of a quaternion may be from 1: what printing with few digits and an optimiser leave.
const UNIT_WITHIN: f64 = 1e-2;
const HINT: &str = "correct the pose in the source, or drop the frame";

/// The rigid motion of a matrix of 12 (3x4) or 16 (4x4) numbers, row by row; `name` is for messages.
pub(crate) fn of_matrix(name: &str, numbers: &[f64]) -> Result<Se3<f64>, SourceErrorCause> {
    let rows: Vec<&[f64]> = numbers.chunks(4).collect();
    of_rows(name, &rows)
}

/// The rigid motion of the rows of a 3x4 or 4x4 matrix.
pub(crate) fn of_rows<R: AsRef<[f64]>>(name: &str, rows: &[R]) -> Result<Se3<f64>, SourceErrorCause> {
    match Pose::from_rows(rows) {
        Ok(Pose(pose)) => Ok(pose),
        Err(cause) => Err(SourceErrorCause::bad(format!("{name} {cause}"), HINT)),
    }
}

/// The rigid motion of the rows of a rotation and a translation.
pub(crate) fn of_rotation(rotation: [[f64; 3]; 3], translation: [f64; 3]) -> Result<Se3<f64>, SourceErrorCause> {
    let row = |i: usize| [rotation[i][0], rotation[i][1], rotation[i][2], translation[i]];
    of_rows("the pose", &[row(0), row(1), row(2)])
}

/// The rigid motion of a place and a quaternion `w x y z`.
pub(crate) fn of_quaternion(place: [f64; 3], [w, x, y, z]: [f64; 4]) -> Result<Se3<f64>, SourceErrorCause> {
    if let Some(value) = place.iter().find(|v| !v.is_finite()) {
        let what = format!("the place of the camera holds {value}");
        return Err(SourceErrorCause::bad(what, HINT));
    }
    let q = Quaternion::new(w, x, y, z);
    let length = q.norm();
    // false for NaN
    let is_unit = (length - 1.0).abs() <= UNIT_WITHIN;
    if !is_unit {
        let what = format!("the quaternion of the camera has length {length:.4}; 1 was expected");
        return Err(SourceErrorCause::bad(what, HINT));
    }
    Ok(Se3 {
        rotation: UnitQuaternion::new_normalize(q).to_rotation_matrix().into_inner(),
        translation: Vector3::from(place),
    })
}

#[cfg(test)]
mod tests {
    use super::{of_quaternion, of_rotation};

    #[test]
    fn non_rotations_are_rejected_and_printed_ones_repaired() {
        // a quarter about z: x goes to y
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let by_quaternion = of_quaternion([1.0, 2.0, 3.0], [half, 0.0, 0.0, half]).unwrap();
        let by_rows = of_rotation([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [1.0, 2.0, 3.0]).unwrap();
        assert!((by_quaternion.matrix() - by_rows.matrix()).amax() < 1e-15);
        let printed = [[0.0004, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        let r = of_rotation(printed, [0.0; 3]).unwrap().rotation;
        assert!((r.transpose() * r - m4_core::nalgebra::Matrix3::identity()).amax() < 1e-12);
        assert!((r - by_rows.rotation).amax() < 1e-3);
        let mirrored = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]];
        for bad in [
            mirrored,
            [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]],
            [[f64::NAN; 3]; 3],
        ] {
            assert!(of_rotation(bad, [0.0; 3]).is_err(), "{bad:?}");
        }
        assert!(of_quaternion([0.0; 3], [0.0; 4]).is_err());
        assert!(of_quaternion([0.0; 3], [f64::NAN, 0.0, 0.0, 1.0]).is_err());
        assert!(of_quaternion([f64::INFINITY, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]).is_err());
    }
}
