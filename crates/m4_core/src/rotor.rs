//! Pairs of unit quaternions as rotations of space-time (docs/spec/optimiser.md 1.2).
//!
//! A space-time vector in storage order `(x, y, z, t)` is the quaternion `t + x i + y j + z k`; the
//! rotor pair `(l, r)` acts as `v -> l v conj(r)`. With `l == r` the time axis stays where it is
//! and the rest is the spatial rotation of [`crate::quat`]; any other pair tilts the time axis,
//! which is a velocity.

use crate::Real;
use nalgebra::{Matrix4, Vector4};

/// Matrix of `v -> q v` on `(w, x, y, z)`.
fn left<T: Real>(q: &Vector4<T>) -> Matrix4<T> {
    let (w, x, y, z) = (q[0], q[1], q[2], q[3]);
    Matrix4::new(w, -x, -y, -z, x, w, -z, y, y, z, w, -x, z, -y, x, w)
}

/// Matrix of `v -> v conj(q)` on `(w, x, y, z)`.
fn right_conj<T: Real>(q: &Vector4<T>) -> Matrix4<T> {
    let (w, x, y, z) = (q[0], -q[1], -q[2], -q[3]);
    Matrix4::new(w, -x, -y, -z, x, w, z, -y, y, -z, w, x, z, y, -x, w)
}

/// From storage order `(x, y, z, t)` to quaternion order `(t, x, y, z)`, both sides.
fn to_quaternion_order<T: Real>(m: &Matrix4<T>) -> Matrix4<T> {
    Matrix4::from_fn(|i, j| m[((i + 3) % 4, (j + 3) % 4)])
}

/// From quaternion order `(t, x, y, z)` to storage order `(x, y, z, t)`, both sides.
fn to_storage_order<T: Real>(m: &Matrix4<T>) -> Matrix4<T> {
    Matrix4::from_fn(|i, j| m[((i + 1) % 4, (j + 1) % 4)])
}

/// The 4D rotation of the pair, each quaternion normalised on use; storage order `(x, y, z, t)`.
pub fn rotation<T: Real>(l: &Vector4<T>, r: &Vector4<T>) -> Matrix4<T> {
    to_storage_order(&(left(&l.normalize()) * right_conj(&r.normalize())))
}

/// Gradients with respect to the unnormalised `l` and `r`, given `g` with respect to
/// [`rotation`]`(l, r)`.
pub fn rotation_vjp<T: Real>(
    l: &Vector4<T>,
    r: &Vector4<T>,
    g: &Matrix4<T>,
) -> (Vector4<T>, Vector4<T>) {
    let (l_unit, r_unit) = (l.normalize(), r.normalize());
    let g = to_quaternion_order(g);
    let g_left = g * right_conj(&r_unit).transpose();
    let g_right = left(&l_unit).transpose() * g;
    let unit = |k: usize| {
        let mut e = Vector4::zeros();
        e[k] = T::one();
        e
    };
    let dl = Vector4::from_fn(|k, _| left(&unit(k)).dot(&g_left));
    let dr = Vector4::from_fn(|k, _| right_conj(&unit(k)).dot(&g_right));
    let through_norm =
        |q: &Vector4<T>, unit: &Vector4<T>, d: Vector4<T>| (d - unit * unit.dot(&d)) / q.norm();
    (through_norm(l, &l_unit, dl), through_norm(r, &r_unit, dr))
}

#[cfg(test)]
mod tests {
    use super::{rotation, rotation_vjp};
    use nalgebra::{Matrix4, Vector4};

    #[test]
    fn a_pair_is_a_rotation_and_equal_quaternions_keep_time() {
        let (l, r) = (
            Vector4::new(0.3, -1.0, 0.2, 0.8),
            Vector4::new(-0.5, 0.4, 0.9, 0.1),
        );
        let m: Matrix4<f64> = rotation(&l, &r);
        assert!(
            (m * m.transpose() - Matrix4::identity()).norm() < 1e-12
                && (m.determinant() - 1.0).abs() < 1e-12
        );
        let space: Matrix4<f64> = rotation(&l, &l);
        assert!((space.fixed_view::<3, 3>(0, 0) - crate::quat::rotation(&l)).norm() < 1e-12);
        assert!((space[(3, 3)] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn vjp_matches_central_differences() {
        let (l, r) = (
            Vector4::new(0.3, -1.0, 0.2, 0.8),
            Vector4::new(-0.5, 0.4, 0.9, 0.1),
        );
        let g = Matrix4::from_fn(|i, j| (i as f64 * 1.7 + j as f64 * 0.9).sin());
        let (dl, dr) = rotation_vjp(&l, &r, &g);
        for k in 0..4 {
            let mut h = Vector4::zeros();
            h[k] = 1e-6;
            let want_l = (rotation(&(l + h), &r) - rotation(&(l - h), &r)).dot(&g) / 2e-6;
            let want_r = (rotation(&l, &(r + h)) - rotation(&l, &(r - h))).dot(&g) / 2e-6;
            assert!((dl[k] - want_l).abs() < 1e-8 && (dr[k] - want_r).abs() < 1e-8);
        }
    }
}
