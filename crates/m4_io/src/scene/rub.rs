//! Rotates worlds by half a turn about x: from y down, z forward to y up, z back, or the other way.
//!
//! Our worlds have the axes of an OpenCV camera (right, down, forward: RDF); glTF and SPZ expect
//! y up (right, up, back: RUB). The turn `F = diag(1, -1, -1)` is its own inverse.

use m4_core::{Column, Splats};

/// Sign that each real spherical harmonic of degree 0 to 3 takes when y and z change theirs: -1 where
/// its polynomial has an odd number of factors y and z.
const HARMONICS: [f32; 16] = [
    1.0, // 1
    -1.0, -1.0, 1.0, // y, z, x
    -1.0, 1.0, 1.0, -1.0, 1.0, // xy, yz, 2zz-xx-yy, xz, xx-yy
    -1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0, // y(..), xyz, y(..), z(..), x(..), z(..), x(..)
];

/// Turns splats; twice is the identity, bit for bit.
pub(crate) fn turn_splats(splats: &mut Splats) {
    let layout = splats.layout();
    for column in [Column::Mean, Column::Velocity] {
        for k in 1..3 {
            negate(splats.column_mut(column, k));
        }
    }
    // F R F: the axes of the Gaussian may point either way
    for k in 2..layout.range(Column::Quat).len() {
        negate(splats.column_mut(Column::Quat, k));
    }
    for term in 0..layout.colour_terms() {
        if HARMONICS[term % layout.sh_terms()] < 0.0 {
            for channel in 0..3 {
                negate(splats.column_mut(Column::Colour, 3 * term + channel));
            }
        }
    }
}

fn negate(column: &mut [f32]) {
    for v in column {
        *v = -*v;
    }
}

#[cfg(test)]
mod tests {
    use super::{HARMONICS, turn_splats};
    use m4_core::{
        Column, SplatLayout, Splats,
        nalgebra::{Vector3, Vector4},
        quat,
    };

    #[test]
    fn rotating_splats_rotates_covariance() {
        let layout = SplatLayout { isotropic: false, sh_degree: 3, time_degree: 0 };
        let mut splats = Splats::zeros(layout, 1, 0);
        for (k, v) in [0.9, -0.3, 0.2, 0.4].into_iter().enumerate() {
            splats.column_mut(Column::Quat, k)[0] = v;
        }
        splats.column_mut(Column::Mean, 1)[0] = 2.0;
        let covariance = |s: &Splats| {
            let q = Vector4::from_fn(|k, _| f64::from(s.column(Column::Quat, k)[0])).normalize();
            let r = quat::rotation(&q);
            r * m4_core::nalgebra::Matrix3::from_diagonal(&Vector3::new(1.0, 4.0, 9.0)) * r.transpose()
        };
        let before = covariance(&splats);
        let mut turned = splats.clone();
        turn_splats(&mut turned);
        let f = m4_core::nalgebra::Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
        assert!((covariance(&turned) - f * before * f).amax() < 1e-6);
        assert_eq!(turned.column(Column::Mean, 1), &[-2.0]);
        turn_splats(&mut turned);
        assert_eq!(turned, splats);
    }

    #[test]
    fn harmonics_change_sign_as_their_polynomials_do() {
        let value = |x: f64, y: f64, z: f64| {
            let (xx, yy, zz) = (x * x, y * y, z * z);
            [
                1.0,
                y,
                z,
                x,
                x * y,
                y * z,
                2.0 * zz - xx - yy,
                x * z,
                xx - yy,
                y * (3.0 * xx - yy),
                x * y * z,
                y * (4.0 * zz - xx - yy),
                z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
                x * (4.0 * zz - xx - yy),
                z * (xx - yy),
                x * (xx - 3.0 * yy),
            ]
        };
        let (here, turned) = (value(0.3, 0.5, 0.7), value(0.3, -0.5, -0.7));
        for l in 0..16 {
            assert!((here[l] * f64::from(HARMONICS[l]) - turned[l]).abs() < 1e-12, "{l}");
        }
    }
}
