//! Quaternions `(w, x, y, z)` as rotation parameters: any non-zero length, normalised on use.

use crate::Real;
use nalgebra::{Matrix3, Vector4};

/// The rotation matrix of `q / |q|`.
pub fn rotation<T: Real>(q: &Vector4<T>) -> Matrix3<T> {
    let n = q / q.norm();
    let (w, x, y, z) = (n[0], n[1], n[2], n[3]);
    let (one, two) = (T::one(), T::of(2.0));
    Matrix3::new(
        one - two * (y * y + z * z),
        two * (x * y - w * z),
        two * (x * z + w * y),
        two * (x * y + w * z),
        one - two * (x * x + z * z),
        two * (y * z - w * x),
        two * (x * z - w * y),
        two * (y * z + w * x),
        one - two * (x * x + y * y),
    )
}

/// Gradient with respect to the unnormalised `q`, given the gradient `g` with respect to
/// [`rotation`]`(q)`. It is orthogonal to `q`, since the length of `q` does not matter.
pub fn rotation_vjp<T: Real>(q: &Vector4<T>, g: &Matrix3<T>) -> Vector4<T> {
    let len = q.norm();
    let n = q / len;
    let (w, x, y, z) = (n[0], n[1], n[2], n[3]);
    let two = T::of(2.0);
    let d = Vector4::new(
        two * (-z * g[(0, 1)] + y * g[(0, 2)] + z * g[(1, 0)] - x * g[(1, 2)] - y * g[(2, 0)]
            + x * g[(2, 1)]),
        two * (y * (g[(0, 1)] + g[(1, 0)])
            + z * (g[(0, 2)] + g[(2, 0)])
            + w * (g[(2, 1)] - g[(1, 2)])
            - two * x * (g[(1, 1)] + g[(2, 2)])),
        two * (x * (g[(0, 1)] + g[(1, 0)])
            + z * (g[(1, 2)] + g[(2, 1)])
            + w * (g[(0, 2)] - g[(2, 0)])
            - two * y * (g[(0, 0)] + g[(2, 2)])),
        two * (x * (g[(0, 2)] + g[(2, 0)])
            + y * (g[(1, 2)] + g[(2, 1)])
            + w * (g[(1, 0)] - g[(0, 1)])
            - two * z * (g[(0, 0)] + g[(1, 1)])),
    );
    (d - n * n.dot(&d)) / len
}

#[cfg(test)]
mod tests {
    use super::{rotation, rotation_vjp};
    use nalgebra::{Matrix3, Vector4};

    #[test]
    fn vjp_matches_central_differences() {
        let q = Vector4::<f64>::new(0.4, -1.2, 0.7, 0.3);
        let g = Matrix3::new(0.3, -1.0, 0.2, 0.9, 0.1, -0.4, 0.6, -0.8, 0.5);
        let got = rotation_vjp(&q, &g);
        for k in 0..4 {
            let mut step = Vector4::zeros();
            step[k] = 1e-6;
            let want =
                ((rotation(&(q + step)) - rotation(&(q - step))).component_mul(&g)).sum() / 2e-6;
            assert!(
                (got[k] - want).abs() < 1e-8,
                "component {k}: {} where {want} was expected",
                got[k]
            );
        }
    }
}
