//! How far apart neighbouring points are.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
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
            let others = near
                .iter()
                .enumerate()
                .filter(|(k, _)| *k != own)
                .map(|(_, n)| n.distance);
            let (sum, count) = others.fold((0.0f32, 0.0f32), |(s, c), d| (s + d, c + 1.0));
            (sum / count.max(1.0)).max(LEAST_SQUARED).sqrt()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::spacing;

    #[test]
    fn a_lattice_has_its_own_spacing() {
        let points: Vec<[f32; 3]> = (0..64)
            .map(|i| [(i % 8) as f32 * 0.5, (i / 8) as f32 * 0.5, 1.0])
            .collect();
        let got = spacing(&points, &[1.0; 64]);
        assert!(
            (got[27] - 0.5).abs() < 1e-6,
            "an inner point has four neighbours at 0.5"
        );
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
}
