//! Converts matrices and quaternions of files to camera-to-world poses, and their axes to OpenCV's.

use crate::{Fault, range};
use m4_core::{
    Se3,
    nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3},
};
use serde::{Deserialize, Serialize};

/// Largest entry of `R^T R - I` that is taken for rounding: matrices are often printed with few
/// digits.
const ORTHONORMAL_WITHIN: f64 = 2e-3;
/// Up to here (f32 rounding) the rotation is taken as it is; beyond, it is made orthonormal.
const EXACT_WITHIN: f64 = 1e-6;
/// How far the length of a quaternion may be from 1: what printing with few digits and an optimiser
/// leave.
const UNIT_WITHIN: f64 = 1e-2;
const HINT: &str = "correct the pose in the source, or drop the frame";

/// Axes of a camera-to-world matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Axes {
    /// x right, y up, z towards the viewer: nerfstudio, Blender.
    #[default]
    OpenGl,
    /// x right, y down, z forward: COLMAP and this program.
    OpenCv,
}

impl Axes {
    /// A pose in these axes as a pose in OpenCV axes, or back: both ways the camera's y and z turn
    /// round.
    #[must_use]
    pub fn to_opencv(self, c2w: &Se3<f64>) -> Se3<f64> {
        let mut turned = *c2w;
        if self == Self::OpenGl {
            turned.rotation.column_mut(1).neg_mut();
            turned.rotation.column_mut(2).neg_mut();
        }
        turned
    }
}

/// The rigid motion of the rows of a 3x4 or 4x4 matrix, made orthonormal if printed digits cost
/// that; `name` is for messages.
pub(crate) fn of_rows<R: AsRef<[f64]>>(name: &str, rows: &[R]) -> Result<Se3<f64>, Fault> {
    let bad = |what: String| Err(Fault::bad(format!("{name} {what}"), HINT));
    let width = rows
        .iter()
        .map(|r| r.as_ref().len())
        .find(|&n| n != 4)
        .unwrap_or(4);
    let height = rows.len();
    if !(3..=4).contains(&height) || width != 4 {
        return bad(format!(
            "has {height} rows of {width} numbers where 4 rows of 4 were expected"
        ));
    }
    let at = |i: usize, j: usize| rows[i].as_ref()[j];
    if let Some(k) = (0..4 * height).find(|k| !at(k / 4, k % 4).is_finite()) {
        let (row, column) = (k / 4, k % 4);
        return bad(format!(
            "holds {} in row {row}, column {column}",
            at(row, column)
        ));
    }
    if height == 4 {
        let last = [at(3, 0), at(3, 1), at(3, 2), at(3, 3)];
        let off = [last[0], last[1], last[2], last[3] - 1.0];
        if off.iter().any(|v| v.abs() > EXACT_WITHIN) {
            return bad(format!(
                "ends with the row {last:?} where [0, 0, 0, 1] was expected (is it transposed?)"
            ));
        }
    }
    let translation = Vector3::new(at(0, 3), at(1, 3), at(2, 3));
    if let Some(what) = range::of_place("translation", &translation) {
        return Err(Fault::bad(format!("{name}: its {what}"), HINT));
    }
    let rotation = Matrix3::from_fn(at);
    let off = (rotation.transpose() * rotation - Matrix3::identity()).amax();
    let determinant = rotation.determinant();
    if off > ORTHONORMAL_WITHIN || determinant < 0.0 {
        return bad(format!(
            "is not a rotation and a translation: its upper left 3x3 part has determinant {determinant:.6} (1 was expected) and its \
             columns differ from orthonormal by {off:.2e}"
        ));
    }
    Ok(Se3 {
        rotation: if off > EXACT_WITHIN {
            nearest_rotation(&rotation)
        } else {
            rotation
        },
        translation,
    })
}

/// Newton's iteration for the orthogonal polar factor: three steps take an error of 2e-3 under
/// rounding (quadratic).
fn nearest_rotation(m: &Matrix3<f64>) -> Matrix3<f64> {
    (0..3).fold(*m, |r, _| match r.try_inverse() {
        Some(inverse) => (r + inverse.transpose()) * 0.5,
        None => r,
    })
}

/// The rigid motion of a matrix of 12 (3x4) or 16 (4x4) numbers, row by row; `name` is for
/// messages.
pub(crate) fn of_matrix(name: &str, numbers: &[f64]) -> Result<Se3<f64>, Fault> {
    let rows: Vec<&[f64]> = numbers.chunks(4).collect();
    of_rows(name, &rows)
}

/// The rigid motion of the rows of a rotation and a translation.
pub(crate) fn of_rotation(
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
) -> Result<Se3<f64>, Fault> {
    let row = |i: usize| {
        [
            rotation[i][0],
            rotation[i][1],
            rotation[i][2],
            translation[i],
        ]
    };
    of_rows("the pose", &[row(0), row(1), row(2)])
}

/// The rigid motion of a place and a quaternion `w x y z`.
pub(crate) fn of_quaternion(place: [f64; 3], [w, x, y, z]: [f64; 4]) -> Result<Se3<f64>, Fault> {
    let translation = Vector3::from(place);
    if let Some(what) = range::of_place("the translation of the camera", &translation) {
        return Err(Fault::bad(what, HINT));
    }
    let q = Quaternion::new(w, x, y, z);
    let length = q.norm();
    // false for NaN
    let is_unit = (length - 1.0).abs() <= UNIT_WITHIN;
    if !is_unit {
        return Err(Fault::bad(
            format!("the quaternion of the camera has length {length:.4}; 1 was expected"),
            HINT,
        ));
    }
    Ok(Se3 {
        rotation: UnitQuaternion::new_normalize(q)
            .to_rotation_matrix()
            .into_inner(),
        translation,
    })
}

#[cfg(test)]
mod tests {
    use super::{Axes, of_quaternion, of_rotation, of_rows};
    use m4_core::{
        Se3,
        nalgebra::{Matrix3, Vector3, Vector6},
    };

    fn rows(pose: &Se3<f64>) -> Vec<Vec<f64>> {
        let m = pose.matrix();
        (0..4)
            .map(|i| (0..4).map(|j| m[(i, j)]).collect())
            .collect()
    }

    #[test]
    fn printed_rotations_are_repaired_and_exact_ones_kept() {
        let pose = Se3::<f64>::identity().retract(&Vector6::new(1.0, 2.0, 3.0, 0.4, -0.8, 0.3));
        assert_eq!(of_rows("", &rows(&pose)).unwrap(), pose);
        let printed: Vec<Vec<f64>> = rows(&pose)
            .iter()
            .map(|r| r.iter().map(|v| (v * 1e3).round() / 1e3).collect())
            .collect();
        let got = of_rows("", &printed).unwrap();
        assert!((got.rotation.transpose() * got.rotation - Matrix3::identity()).amax() < 1e-12);
        assert!((got.rotation - pose.rotation).amax() < 2e-3);
        // a quarter about z: x goes to y
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let by_quaternion = of_quaternion([1.0, 2.0, 3.0], [half, 0.0, 0.0, half]).unwrap();
        let by_rows = of_rotation(
            [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
            [1.0, 2.0, 3.0],
        )
        .unwrap();
        assert!((by_quaternion.matrix() - by_rows.matrix()).amax() < 1e-15);
    }

    #[test]
    fn other_matrices_are_refused_with_the_reason() {
        type Spoil = fn(&mut Vec<Vec<f64>>);
        let cases: [(Spoil, &str); 5] = [
            (|m| m[0][0] = -1.0, "determinant -1.0"),
            (|m| (0..3).for_each(|i| m[i][i] = 2.0), "determinant 8.0"),
            (|m| m[3][0] = 5.0, "transposed"),
            (|m| m.truncate(2), "2 rows"),
            (|m| m[1][2] = f64::NAN, "row 1, column 2"),
        ];
        for (spoil, says) in cases {
            let mut m = rows(&Se3::identity());
            spoil(&mut m);
            let message = of_rows("c2w", &m).unwrap_err().to_string();
            assert!(
                message.starts_with("c2w ") && message.contains(says),
                "{message}"
            );
        }
        for (place, quat) in [
            ([0.0; 3], [0.0; 4]),
            ([0.0; 3], [f64::NAN, 0.0, 0.0, 1.0]),
            ([f64::INFINITY, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]),
        ] {
            assert!(of_quaternion(place, quat).is_err());
        }
    }

    #[test]
    fn an_opengl_camera_looks_along_minus_z() {
        let c2w = Axes::OpenGl.to_opencv(&Se3::identity());
        // Forward (OpenCV z) and down (OpenCV y) in the world of an OpenGL camera at rest.
        assert_eq!(c2w.transform(&Vector3::z()), -Vector3::z());
        assert_eq!(c2w.transform(&Vector3::y()), -Vector3::y());
        assert_eq!(c2w.transform(&Vector3::x()), Vector3::x());
        assert_eq!(Axes::OpenGl.to_opencv(&c2w), Se3::identity());
    }
}
