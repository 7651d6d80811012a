//! The spacing and local orientation of neighbouring points.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use m4_core::nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use std::num::NonZero;

/// Smallest squared distance that counts: coincident points still get a size (Inria's reference).
const LEAST_SQUARED: f32 = 1e-7;

/// Root of the mean squared distance to the three nearest other points, world units, `[n]`.
/// Fewer than two points have no neighbour: `fallback` is returned for them.
pub(crate) fn spacing(points: &[[f32; 3]], fallback: &[f32]) -> Vec<f32> {
    const FOUR: NonZero<usize> = NonZero::new(4).unwrap();
    let tree = match ImmutableKdTree::<f32, 3>::new_from_slice(points) {
        Ok(tree) if points.len() > 1 => tree,
        _ => return fallback.to_vec(),
    };
    points
        .par_iter()
        .enumerate()
        .map(|(i, p)| {
            let near = tree.query(p).nearest_n::<SquaredEuclidean<f32>>(FOUR).execute();
            // One of the four is the point itself, whichever of its duplicates is named first.
            let own = near.iter().position(|n| n.item as usize == i).unwrap_or(0);
            let others = near.iter().enumerate().filter(|(k, _)| *k != own).map(|(_, n)| n.distance);
            let (sum, count) = others.fold((0.0f32, 0.0f32), |(s, c), d| (s + d, c + 1.0));
            (sum / count.max(1.0)).max(LEAST_SQUARED).sqrt()
        })
        .collect()
}

/// How the neighbourhood of a point is spread.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Spread {
    /// Root mean square distance of the neighbours along each axis, world units.
    pub sd: [f32; 3],
    /// Rotation of the axes into the world, quaternion `(w, x, y, z)`.
    pub quat: [f32; 4],
}

/// Principal axes of the `count` nearest points, the point itself among them, around each point.
pub(crate) fn spread(points: &[[f32; 3]], count: usize) -> Vec<Spread> {
    let nothing = Spread { sd: [0.0; 3], quat: [1.0, 0.0, 0.0, 0.0] };
    let (Ok(tree), Some(count)) =
        (ImmutableKdTree::<f32, 3>::new_from_slice(points), NonZero::new(count.min(points.len())))
    else {
        return vec![nothing; points.len()];
    };
    points
        .par_iter()
        .map(|p| {
            let near = tree.query(p).nearest_n::<SquaredEuclidean<f32>>(count).execute();
            let mut second = Matrix3::<f64>::zeros();
            for n in &near {
                let q = points[n.item as usize];
                let d = Vector3::from([0, 1, 2].map(|k| f64::from(q[k]) - f64::from(p[k])));
                second += d * d.transpose();
            }
            second /= (near.len().max(2) - 1) as f64;
            let Some(found) = second.try_symmetric_eigen(f64::EPSILON, 100) else {
                return nothing;
            };
            let mut axes = found.eigenvectors;
            if axes.determinant() < 0.0 {
                axes.column_mut(2).neg_mut();
            }
            let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
            Spread {
                sd: [0, 1, 2].map(|k| found.eigenvalues[k].max(0.0).sqrt() as f32),
                quat: [q.w, q.i, q.j, q.k].map(|v| v as f32),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::{spacing, spread};
    use m4_core::nalgebra::{Quaternion, UnitQuaternion, Vector3};

    #[test]
    fn a_lattice_has_its_own_spacing() {
        let points: Vec<[f32; 3]> = (0..64).map(|i| [(i % 8) as f32 * 0.5, (i / 8) as f32 * 0.5, 1.0]).collect();
        let got = spacing(&points, &[1.0; 64]);
        assert!((got[27] - 0.5).abs() < 1e-6, "an inner point has four neighbours at 0.5");
        // a corner: two at 0.5 and one at the diagonal
        assert!((got[0] - ((0.25 + 0.25 + 0.5) / 3.0f32).sqrt()).abs() < 1e-6);
    }

    #[test]
    fn duplicates_and_lone_points_get_a_size() {
        assert_eq!(spacing(&[[1.0, 2.0, 3.0]], &[0.7]), [0.7]);
        assert!(spacing(&[], &[]).is_empty());
        let many = spacing(&[[1.0, 1.0, 1.0]; 200], &[1.0; 200]);
        assert!(many.iter().all(|&s| s > 0.0 && s < 1e-3));
    }

    /// A lattice of 0.5 by 0.25 in a tilted plane: a disc twice as long as wide, flat across the plane.
    #[test]
    fn a_tilted_lattice_is_spread_along_its_axes() {
        let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(0.7f32, -0.4, 0.2));
        let points: Vec<[f32; 3]> =
            (0..81).map(|i| (tilt * Vector3::new((i % 9) as f32 * 0.5, (i / 9) as f32 * 0.25, 0.0)).into()).collect();
        let got = spread(&points, 9)[40];
        let q = UnitQuaternion::from_quaternion(Quaternion::new(got.quat[0], got.quat[1], got.quat[2], got.quat[3]));
        let flat = (0..3).min_by(|&a, &b| got.sd[a].total_cmp(&got.sd[b])).unwrap();
        assert!(got.sd[flat] < 1e-3, "{got:?}");
        let normal = q * Vector3::ith(flat, 1.0);
        assert!(normal.dot(&(tilt * Vector3::z())).abs() > 0.9999);
        let long = (0..3).max_by(|&a, &b| got.sd[a].total_cmp(&got.sd[b])).unwrap();
        // nearest nine: one row of three, two of the next, and the far ones of the short axis
        assert!(got.sd[long] > 0.2 && got.sd[long] < 0.6, "{got:?}");
    }

    #[test]
    fn too_few_points_have_no_axes() {
        assert_eq!(spread(&[[1.0; 3]], 9)[0].sd, [0.0; 3]);
        assert_eq!(spread(&[[1.0; 3]; 2], 0)[1].quat, [1.0, 0.0, 0.0, 0.0]);
        assert!(spread(&[[f32::NAN; 3]; 4], 3).len() == 4);
        assert!(spread(&[], 9).is_empty());
    }
}
