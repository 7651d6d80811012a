//! Rotations that files claim to be such.

use crate::core::SourceFault;
use m4_math::Se3;
use m4_math::nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// Largest entry of `R^T R - 1` that is taken for rounding: matrices are often printed with few digits.
const ORTHONORMAL_WITHIN: f64 = 2e-3;
/// Up to here (f32 rounding) the rotation is taken as it is; beyond, it is made orthonormal.
const EXACT_WITHIN: f64 = 1e-6;
/// How far the length of a quaternion may be from 1.
const UNIT_WITHIN: f64 = 1e-2;

const REMEDY: &str = "correct the pose in the source";

/// A rotation by its rows and a translation.
pub(crate) fn from_rows(rotation: [[f64; 3]; 3], translation: [f64; 3]) -> Result<Se3<f64>, SourceFault> {
    let r = Matrix3::from_fn(|i, j| rotation[i][j]);
    let t = Vector3::from(translation);
    if !r.iter().chain(t.iter()).all(|v| v.is_finite()) {
        return Err(SourceFault::bad("a value is not a number", REMEDY));
    }
    let off = (r.transpose() * r - Matrix3::identity()).amax();
    let determinant = r.determinant();
    if off > ORTHONORMAL_WITHIN || determinant < 0.0 {
        let what = format!(
            "not a rotation: the determinant is {determinant:.6} (1 was expected) and the columns differ from orthonormal by {off:.2e}"
        );
        return Err(SourceFault::bad(what, REMEDY));
    }
    let rotation = if off > EXACT_WITHIN {
        UnitQuaternion::from_matrix(&r).to_rotation_matrix().into_inner()
    } else {
        r
    };
    Ok(Se3 {
        rotation,
        translation: t,
    })
}

/// A rotation by a quaternion `[x, y, z, w]` and a translation.
pub(crate) fn from_quaternion_xyzw(q: [f64; 4], translation: [f64; 3]) -> Result<Se3<f64>, SourceFault> {
    let [x, y, z, w] = q;
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    if !(translation.iter().all(|v| v.is_finite()) && (norm - 1.0).abs() <= UNIT_WITHIN) {
        let what = format!("the quaternion {q:?} and the place {translation:?}; length 1 and numbers were expected");
        return Err(SourceFault::bad(what, REMEDY));
    }
    Ok(Se3 {
        rotation: UnitQuaternion::from_quaternion(quaternion)
            .to_rotation_matrix()
            .into_inner(),
        translation: Vector3::from(translation),
    })
}

#[cfg(test)]
mod tests {
    use super::{from_quaternion_xyzw, from_rows};

    #[test]
    fn rotations_are_told_from_what_is_none() {
        // a quarter about z: x goes to y
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let by_quaternion = from_quaternion_xyzw([0.0, 0.0, half, half], [1.0, 2.0, 3.0]).unwrap();
        let by_rows = from_rows([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [1.0, 2.0, 3.0]).unwrap();
        assert!((by_quaternion.matrix() - by_rows.matrix()).amax() < 1e-15);
        let printed = [[0.0004, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        let r = from_rows(printed, [0.0; 3]).unwrap().rotation;
        assert!((r.transpose() * r - m4_math::nalgebra::Matrix3::identity()).amax() < 1e-12);
        assert!((r - by_rows.rotation).amax() < 1e-3);
        let mirrored = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]];
        for bad in [
            mirrored,
            [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]],
            [[f64::NAN; 3]; 3],
        ] {
            assert!(from_rows(bad, [0.0; 3]).is_err(), "{bad:?}");
        }
        assert!(from_quaternion_xyzw([0.0; 4], [0.0; 3]).is_err());
        assert!(from_quaternion_xyzw([0.0, 0.0, 0.0, 1.0], [f64::INFINITY, 0.0, 0.0]).is_err());
    }
}
