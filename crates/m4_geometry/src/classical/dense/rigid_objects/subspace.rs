//! Paths in the image of the points of one rigid body: over a short time they lie in a space of
//! three dimensions around their mean (Tomasi and Kanade 1992).

use super::rigid::NOISE_PX;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Root mean square distance of a path from the space up to which it belongs to the body, pixels at
/// the working size.
const NEAR_PX: f64 = NOISE_PX;
/// Least share of the frames in which a path must be known.
const LEAST_KNOWN: f64 = 0.5;
/// Fits to the paths that are near.
const ROUNDS: usize = 5;
/// Lengths below this share of the longest are none.
const FLAT: f64 = 1e-6;

/// Paths of one rigid body: x and y by frame.
pub(super) struct Space {
    mean: DVector<f64>,
    basis: DMatrix<f64>,
}

impl Space {
    /// The space of most of the variance of paths that are known in all frames.
    pub fn of(paths: &[&[f64]]) -> Option<Self> {
        let rows = paths.first()?.len();
        let count = paths.len() as f64;
        let mean = DVector::from_fn(rows, |r, _| paths.iter().map(|p| p[r]).sum::<f64>() / count);
        let centred = DMatrix::from_fn(rows, paths.len(), |r, c| paths[c][r] - mean[r]);
        // The smaller of both square matrices has the same directions.
        let columns: Vec<DVector<f64>> = if paths.len() < rows {
            let eigen = (centred.transpose() * &centred).symmetric_eigen();
            largest(eigen.eigenvalues.as_slice())
                .map(|i| &centred * eigen.eigenvectors.column(i))
                .collect()
        } else {
            let eigen = (&centred * centred.transpose()).symmetric_eigen();
            largest(eigen.eigenvalues.as_slice())
                .map(|i| eigen.eigenvectors.column(i).into_owned())
                .collect()
        };
        let basis = orthonormal(columns)?;
        Some(Self { mean, basis })
    }

    /// How far a path, not a number where it is unknown, belongs to the body: 1 in the space, 0
    /// from [`NEAR_PX`] on.
    pub fn share(&self, path: &[f64]) -> f64 {
        let distance = self.distance(path).unwrap_or(f64::INFINITY);
        (1.0 - (distance / NEAR_PX).powi(2)).max(0.0)
    }

    /// Root mean square distance of a path from the space over the frames in which it is known.
    fn distance(&self, path: &[f64]) -> Option<f64> {
        let direction = |r: usize| Vector3::from_fn(|i, _| self.basis[(r, i)]);
        let known = || (0..path.len()).filter(|&r| !path[r].is_nan());
        let (mut normal, mut right) = (Matrix3::identity() * FLAT, Vector3::zeros());
        for r in known() {
            let b = direction(r);
            normal += b * b.transpose();
            right += b * (path[r] - self.mean[r]);
        }
        let count = known().count();
        if (count as f64) < LEAST_KNOWN * path.len() as f64 {
            return None;
        }
        let at = normal.cholesky()?.solve(&right);
        let off = |r: usize| path[r] - self.mean[r] - direction(r).dot(&at);
        let squares: f64 = known().map(|r| off(r).powi(2)).sum();
        Some((2.0 * squares / count as f64).sqrt())
    }

    /// Fits again to the paths that are near until it settles; `None` if there are fewer than
    /// `least`.
    pub fn settle(mut self, paths: &[&[f64]], least: usize) -> Option<Self> {
        for _ in 0..ROUNDS {
            let near: Vec<&[f64]> = (paths.iter().copied())
                .filter(|path| self.share(path) > 0.0)
                .collect();
            if near.len() < least {
                return None;
            }
            self = Self::of(&near)?;
        }
        Some(self)
    }
}

/// The places of the three largest values.
fn largest(values: &[f64]) -> impl Iterator<Item = usize> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[b].total_cmp(&values[a]));
    order.into_iter().take(3)
}

/// Makes three columns orthonormal; those without a direction of their own become 0.
fn orthonormal(columns: Vec<DVector<f64>>) -> Option<DMatrix<f64>> {
    let longest = columns.first()?.norm();
    let rows = columns.first()?.len();
    let mut out: Vec<DVector<f64>> = Vec::new();
    for mut column in columns {
        for before in out.iter().chain(&out) {
            let along = before.dot(&column);
            column.axpy(-along, before, 1.0);
        }
        let norm = column.norm();
        column *= if norm > FLAT * longest {
            1.0 / norm
        } else {
            0.0
        };
        out.push(column);
    }
    out.resize(3, DVector::zeros(rows));
    (longest > 0.0).then(|| DMatrix::from_columns(&out))
}

#[cfg(test)]
mod tests {
    use super::Space;
    use nalgebra::{Rotation3, Vector3};

    /// Paths of points that turn by 2 degrees a frame, `bend` times faster on the right.
    fn paths(bend: f64) -> Vec<Vec<f64>> {
        let path = |i: usize| -> Vec<f64> {
            let point = Vector3::new(
                (i % 6) as f64 - 2.5,
                (i / 6) as f64 - 2.5,
                (i * 7 % 5) as f64,
            );
            let rate = if point.x > 0.0 { bend } else { 1.0 };
            let at = |k: usize| {
                let turn = Rotation3::new(Vector3::new(0.02, 0.035, 0.01) * k as f64 * rate);
                let p = turn * point * 8.0;
                [p.x + 3.0 * k as f64, p.y]
            };
            (0..17).flat_map(at).collect()
        };
        (0..36).map(path).collect()
    }

    #[test]
    fn paths_of_one_body_are_in_its_space_and_others_are_not() {
        let rigid = paths(1.0);
        let all: Vec<&[f64]> = rigid.iter().map(Vec::as_slice).collect();
        let space = Space::of(&all).unwrap();
        assert!(all.iter().all(|path| space.share(path) > 0.9));
        // A path that is lost half way.
        let mut lost = rigid[3].clone();
        lost[20..].fill(f64::NAN);
        assert!(space.share(&lost) > 0.9);
        lost[10..].fill(f64::NAN);
        assert_eq!(space.share(&lost), 0.0);
        // The right half turns the other way.
        let bent = paths(-1.0);
        let left: Vec<&[f64]> = (bent.iter().map(Vec::as_slice))
            .filter(|path| path[0] < 0.0)
            .collect();
        let all: Vec<&[f64]> = bent.iter().map(Vec::as_slice).collect();
        let space = Space::of(&left).unwrap();
        for path in all {
            let share = space.share(path);
            let at = path[0];
            assert!(at > 0.0 || share > 0.9, "{at} {share}");
            assert!(at < 15.0 || share < 0.5, "{at} {share}");
        }
    }
}
