//! Poses in MegaSaM's files: camera-to-world matrices, and translations with quaternions, world to camera.

use super::MegasamFault;
use crate::capture::Pose;
use m4_core::{
    Se3,
    nalgebra::{Quaternion, UnitQuaternion, Vector3},
};

/// How far the length of a quaternion may be from 1: f32, and what a bundle adjustment leaves.
const UNIT_WITHIN: f64 = 1e-2;

/// Camera to world of a matrix `[4][4]` of `cam_c2w`.
pub(super) fn of_matrix(frame: usize, m: &[f64]) -> Result<Se3<f64>, MegasamFault> {
    let rows: Vec<&[f64]> = m.chunks_exact(4).collect();
    match Pose::from_rows(&rows) {
        Ok(Pose(pose)) => Ok(pose),
        Err(fault) => Err(MegasamFault::Value {
            array: "cam_c2w",
            frame,
            what: format!("the matrix {fault}"),
        }),
    }
}

/// Camera to world of `tx ty tz qx qy qz qw`, world to camera.
pub(super) fn of_w2c(frame: usize, p: &[f64]) -> Result<Se3<f64>, MegasamFault> {
    let bad = |what: String| MegasamFault::Value {
        array: "poses",
        frame,
        what,
    };
    if let Some(value) = p.iter().find(|v| !v.is_finite()) {
        return Err(bad(format!("it holds {value}")));
    }
    let q = Quaternion::new(p[6], p[3], p[4], p[5]);
    if (q.norm() - 1.0).abs() > UNIT_WITHIN {
        return Err(bad(format!(
            "its quaternion has length {:.4}; tx ty tz qx qy qz qw with a length of 1 was expected",
            q.norm()
        )));
    }
    let w2c = Se3 {
        rotation: *UnitQuaternion::from_quaternion(q).to_rotation_matrix().matrix(),
        translation: Vector3::new(p[0], p[1], p[2]),
    };
    Ok(w2c.inverse())
}

#[cfg(test)]
mod tests {
    use super::of_w2c;

    #[test]
    fn poses_are_inverted_and_what_is_none_is_named() {
        // a quarter turn about y, then 3 along z: qw is the last number
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let c2w = of_w2c(0, &[0.0, 0.0, 3.0, 0.0, half, 0.0, half]).unwrap();
        let w2c = c2w.inverse();
        let x = w2c.transform(&m4_core::nalgebra::Vector3::new(0.0, 0.0, 1.0));
        assert!((x - m4_core::nalgebra::Vector3::new(1.0, 0.0, 3.0)).norm() < 1e-12);
        assert!(of_w2c(3, &[0.0; 7]).unwrap_err().to_string().contains("frame 3"));
        assert!(of_w2c(0, &[f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]).is_err());
    }
}
