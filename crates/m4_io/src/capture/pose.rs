//! Checks that a 4x4 matrix from a file is a rigid motion.

use m4_core::{Se3, nalgebra::Matrix3, nalgebra::Vector3};

/// Largest entry of `R^T R - I` that is taken for rounding: matrices are often printed with few digits.
const ORTHONORMAL_WITHIN: f64 = 2e-3;
/// Up to here (f32 rounding) the rotation is taken as it is; beyond, it is made orthonormal.
const EXACT_WITHIN: f64 = 1e-6;

/// Why a matrix is no pose.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PoseError {
    /// Not 4 rows (or 3, without the last) of 4 numbers.
    #[error("has {rows} rows of {columns} numbers where 4 rows of 4 were expected")]
    Shape {
        /// The number of them.
        rows: usize,
        /// Length of the first that is not 4 long.
        columns: usize,
    },
    /// NaN or infinity.
    #[error("holds {value} in row {row}, column {column}")]
    NotFinite {
        /// Counted from 0.
        row: usize,
        /// Counted from 0.
        column: usize,
        /// What is there.
        value: f64,
    },
    /// The last row is not `0 0 0 1`.
    #[error("ends with the row {row:?} where [0, 0, 0, 1] was expected (is it transposed?)")]
    LastRow {
        /// What is there.
        row: [f64; 4],
    },
    /// Scaled, sheared or mirrored.
    #[error(
        "is not a rotation and a translation: its upper left 3x3 part has determinant {determinant:.6} (1 was expected) and its columns differ from orthonormal by {off:.2e}"
    )]
    NotRotation {
        /// Of the upper left 3x3 part.
        determinant: f64,
        /// Largest entry of `R^T R - I`.
        off: f64,
    },
}

/// A checked rigid motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose(pub Se3<f64>);

impl Pose {
    /// Takes rows of a 4x4 (or 3x4) matrix. A rotation that is off by what printing with few digits does is made orthonormal.
    ///
    /// # Errors
    ///
    /// [`PoseError`], in words that follow the name of the matrix.
    pub fn from_rows<R: AsRef<[f64]>>(rows: &[R]) -> Result<Self, PoseError> {
        let width = rows.iter().map(|r| r.as_ref().len()).find(|&n| n != 4).unwrap_or(4);
        if !(3..=4).contains(&rows.len()) || width != 4 {
            return Err(PoseError::Shape {
                rows: rows.len(),
                columns: width,
            });
        }
        for (row, values) in rows.iter().enumerate() {
            for (column, &value) in values.as_ref().iter().enumerate() {
                if !value.is_finite() {
                    return Err(PoseError::NotFinite { row, column, value });
                }
            }
        }
        let at = |i: usize, j: usize| rows[i].as_ref()[j];
        if rows.len() == 4 {
            let last = [at(3, 0), at(3, 1), at(3, 2), at(3, 3)];
            let off = [last[0], last[1], last[2], last[3] - 1.0];
            if off.iter().any(|v| v.abs() > EXACT_WITHIN) {
                return Err(PoseError::LastRow { row: last });
            }
        }
        let rotation = Matrix3::from_fn(at);
        let off = (rotation.transpose() * rotation - Matrix3::identity()).amax();
        let determinant = rotation.determinant();
        if off > ORTHONORMAL_WITHIN || determinant < 0.0 {
            return Err(PoseError::NotRotation { determinant, off });
        }
        Ok(Self(Se3 {
            rotation: if off > EXACT_WITHIN {
                nearest_rotation(&rotation)
            } else {
                rotation
            },
            translation: Vector3::new(at(0, 3), at(1, 3), at(2, 3)),
        }))
    }
}

/// Newton's iteration for the orthogonal polar factor, `R <- (R + R^-T) / 2`: it converges
/// quadratically, so three steps take an error of 2e-3 under rounding.
fn nearest_rotation(m: &Matrix3<f64>) -> Matrix3<f64> {
    (0..3).fold(*m, |r, _| match r.try_inverse() {
        Some(inverse) => (r + inverse.transpose()) * 0.5,
        None => r,
    })
}

#[cfg(test)]
mod tests {
    use super::{Pose, PoseError};
    use m4_core::{Se3, nalgebra::Matrix3, nalgebra::Vector6};

    fn rows(pose: &Se3<f64>) -> Vec<Vec<f64>> {
        let m = pose.matrix();
        (0..4).map(|i| (0..4).map(|j| m[(i, j)]).collect()).collect()
    }

    #[test]
    fn printed_rotations_are_repaired_and_exact_ones_kept() {
        let pose = Se3::<f64>::identity().retract(&Vector6::new(1.0, 2.0, 3.0, 0.4, -0.8, 0.3));
        assert_eq!(Pose::from_rows(&rows(&pose)).unwrap().0, pose);
        let printed: Vec<Vec<f64>> = rows(&pose)
            .iter()
            .map(|r| r.iter().map(|v| (v * 1e3).round() / 1e3).collect())
            .collect();
        let got = Pose::from_rows(&printed).unwrap().0;
        assert!((got.rotation.transpose() * got.rotation - Matrix3::identity()).amax() < 1e-12);
        assert!((got.rotation - pose.rotation).amax() < 2e-3);
    }

    #[test]
    fn other_matrices_are_refused_with_the_reason() {
        let mut mirrored = rows(&Se3::identity());
        mirrored[0][0] = -1.0;
        let mut scaled = rows(&Se3::identity());
        (0..3).for_each(|i| scaled[i][i] = 2.0);
        let mut transposed = rows(&Se3::identity());
        transposed[3][0] = 5.0;
        let is = |m: &[Vec<f64>]| Pose::from_rows(m).err().unwrap();
        assert!(matches!(is(&mirrored), PoseError::NotRotation { determinant, .. } if determinant == -1.0));
        assert!(is(&scaled).to_string().contains("determinant 8.0"));
        assert!(matches!(is(&transposed), PoseError::LastRow { .. }));
        assert!(matches!(is(&scaled[..2]), PoseError::Shape { rows: 2, .. }));
        scaled[1][2] = f64::NAN;
        assert!(matches!(is(&scaled), PoseError::NotFinite { row: 1, column: 2, .. }));
    }
}
