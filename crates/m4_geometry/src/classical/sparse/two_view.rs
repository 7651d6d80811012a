//! Two frames related by a rigid motion: five-point samples, truncated Sampson errors.

use super::INLIER_PX;
use m4_core::{
    CounterRng, Se3,
    nalgebra::{Matrix3, SMatrix, Schur, Vector3},
};

/// Matches of two frames, working pixels from the image centre.
pub(crate) type Match = ([f64; 2], [f64; 2]);

#[derive(Debug, Clone)]
pub(crate) struct TwoView {
    /// First camera to second camera; translation of length 1.
    pub motion: Se3<f64>,
    pub inliers: Vec<usize>,
    /// Mean of `1 - min(error / INLIER_PX, 1)^2` over all matches: 1 for perfect agreement.
    pub score: f64,
}

/// Random samples of five matches.
const SAMPLES: usize = 150;

/// The essential matrix that most matches agree with (MSAC), for a focal length in working pixels.
///
/// Returns `None` for fewer than 8 matches, or when no sample gives a motion with points in front
/// of both cameras.
pub(crate) fn relate(matches: &[Match], focal: f64, seed: u64, purpose: u64) -> Option<TwoView> {
    if matches.len() < 8 {
        return None;
    }
    let ray = |p: [f64; 2]| Vector3::new(p[0] / focal, p[1] / focal, 1.0);
    let rays: Vec<(Vector3<f64>, Vector3<f64>)> =
        matches.iter().map(|m| (ray(m.0), ray(m.1))).collect();
    let limit = (INLIER_PX / focal).powi(2);
    let mut best: Option<(f64, Matrix3<f64>)> = None;
    for sample in 0..SAMPLES {
        let mut rng = CounterRng::new(seed, purpose, sample as u64);
        let picked = distinct_five(&mut rng, rays.len());
        let candidates = essential_matrices(&picked.map(|i| rays[i].0), &picked.map(|i| rays[i].1));
        for e in candidates {
            let score = score(&e, &rays, limit, best.map_or(0.0, |(s, _)| s));
            if best.is_none_or(|(s, _)| score > s) {
                best = Some((score, e));
            }
        }
    }
    let (score, e) = best?;
    let inliers: Vec<usize> = (0..rays.len())
        .filter(|&i| sampson(&e, &rays[i]) < limit)
        .collect();
    let motion = decompose(&e, inliers.iter().map(|&i| &rays[i]))?;
    Some(TwoView {
        motion,
        inliers,
        score: score / rays.len() as f64,
    })
}

/// Five different numbers below `n`, `n >= 5`.
fn distinct_five(rng: &mut CounterRng, n: usize) -> [usize; 5] {
    let mut picked = [usize::MAX; 5];
    for k in 0..5 {
        loop {
            let i = rng.below(n);
            if !picked[..k].contains(&i) {
                picked[k] = i;
                break;
            }
        }
    }
    picked
}

/// Squared Sampson error of a pair of rays, in units of the normalised image.
fn sampson(e: &Matrix3<f64>, (a, b): &(Vector3<f64>, Vector3<f64>)) -> f64 {
    let (ea, eb) = (e * a, e.tr_mul(b));
    let r = b.dot(&ea);
    r * r / (ea.x * ea.x + ea.y * ea.y + eb.x * eb.x + eb.y * eb.y).max(1e-300)
}

/// Sum of `1 - min(error^2 / limit, 1)`; gives up once `to_beat` is out of reach.
fn score(e: &Matrix3<f64>, rays: &[(Vector3<f64>, Vector3<f64>)], limit: f64, to_beat: f64) -> f64 {
    let mut sum = 0.0;
    for (i, pair) in rays.iter().enumerate() {
        sum += (1.0 - sampson(e, pair) / limit).max(0.0);
        if i % 64 == 63 && sum + (rays.len() - i - 1) as f64 <= to_beat {
            break;
        }
    }
    sum
}

/// The motion among the four of `e` that puts most points in front of both cameras.
fn decompose<'a>(
    e: &Matrix3<f64>,
    rays: impl Iterator<Item = &'a (Vector3<f64>, Vector3<f64>)> + Clone,
) -> Option<Se3<f64>> {
    let svd = e.svd(true, true);
    let (mut u, mut v_t) = (svd.u?, svd.v_t?);
    if u.determinant() < 0.0 {
        u = -u;
    }
    if v_t.determinant() < 0.0 {
        v_t = -v_t;
    }
    let w = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let t: Vector3<f64> = u.column(2).into_owned();
    let mut best: Option<(usize, Se3<f64>)> = None;
    for rotation in [u * w * v_t, u * w.transpose() * v_t] {
        for translation in [t, -t] {
            let motion = Se3 {
                rotation,
                translation,
            };
            let front = rays.clone().filter(|pair| in_front(&motion, pair)).count();
            if best.as_ref().is_none_or(|(n, _)| front > *n) {
                best = Some((front, motion));
            }
        }
    }
    best.filter(|(front, _)| *front > 0)
        .map(|(_, motion)| motion)
}

/// True when the rays meet in front of both cameras.
fn in_front(motion: &Se3<f64>, (a, b): &(Vector3<f64>, Vector3<f64>)) -> bool {
    // depth_b * b = depth_a * R a + t, in the sense of least squares.
    let ra = motion.rotation * a;
    let (aa, bb, ab) = (ra.norm_squared(), b.norm_squared(), ra.dot(b));
    let (at, bt) = (ra.dot(&motion.translation), b.dot(&motion.translation));
    let determinant = aa * bb - ab * ab;
    let depth_a = (ab * bt - bb * at) / determinant;
    let depth_b = (aa * bt - ab * at) / determinant;
    depth_a > 0.0 && depth_b > 0.0
}

/// Exponents of `x, y, z` of the twenty monomials as decimal digits (a product is a sum): ten of
/// degree 3, then the basis of the quotient.
const MONOMIALS: [u16; 20] = [
    300, 210, 120, 30, 201, 111, 21, 102, 12, 3, 200, 110, 20, 101, 11, 2, 100, 10, 1, 0,
];

/// Where the product of two monomials lies; 20 where its degree exceeds 3.
const PRODUCT: [[usize; 20]; 20] = product_table();

const fn product_table() -> [[usize; 20]; 20] {
    let mut table = [[20; 20]; 20];
    let mut i = 0;
    while i < 20 {
        let mut j = 0;
        while j < 20 {
            let mut k = 0;
            while k < 20 {
                if MONOMIALS[i] + MONOMIALS[j] == MONOMIALS[k] {
                    table[i][j] = k;
                }
                k += 1;
            }
            j += 1;
        }
        i += 1;
    }
    table
}

/// A polynomial in `x, y, z` of degree at most 3.
type Cubic = [f64; 20];

/// `sum += factor * a * b`, where `a` starts at monomial `from_a` and `b` at `from_b` (16: linear,
/// 10: quadratic).
fn add_product(sum: &mut Cubic, factor: f64, a: &Cubic, from_a: usize, b: &Cubic, from_b: usize) {
    for i in from_a..20 {
        for j in from_b..20 {
            sum[PRODUCT[i][j]] += factor * a[i] * b[j];
        }
    }
}

/// The essential matrices `E` with `second^T E first = 0` for five pairs of rays `(x, y, 1)`; at
/// most ten. Empty for degenerate samples.
///
/// Nistér's problem (2004) in the form of Stewénius, Engels and Nistér (2006): the four-dimensional
/// null space of the epipolar equations, ten cubic constraints on it, and the eigenvectors of the
/// matrix of "multiplication by x" in the quotient ring.
fn essential_matrices(first: &[Vector3<f64>; 5], second: &[Vector3<f64>; 5]) -> Vec<Matrix3<f64>> {
    let mut equations = SMatrix::<f64, 9, 9>::zeros();
    for k in 0..5 {
        for i in 0..3 {
            for j in 0..3 {
                equations[(k, 3 * i + j)] = second[k][i] * first[k][j];
            }
        }
    }
    let Some(v_t) = equations.svd(false, true).v_t else {
        return Vec::new();
    };
    // E = x E0 + y E1 + z E2 + E3
    let basis: [Matrix3<f64>; 4] =
        std::array::from_fn(|b| Matrix3::from_fn(|i, j| v_t[(5 + b, 3 * i + j)]));
    let action = action_matrix(&basis);
    let Some((action, schur)) =
        action.and_then(|action| Some((action, Schur::try_new(action, 1e-12, 300)?)))
    else {
        return Vec::new();
    };
    let mut matrices = Vec::new();
    for value in schur.complex_eigenvalues().iter() {
        if value.im.abs() > 1e-8 * (1.0 + value.re.abs()) {
            continue;
        }
        // One step of inverse iteration, slightly off the eigenvalue, gives the eigenvector.
        let shifted = action
            - SMatrix::<f64, 10, 10>::identity() * (value.re + 1e-9 * (1.0 + value.re.abs()));
        let Some(v) = shifted.lu().solve(&SMatrix::<f64, 10, 1>::repeat(1.0)) else {
            continue;
        };
        let e = (basis[0] * v[6] + basis[1] * v[7] + basis[2] * v[8]) / v[9] + basis[3];
        let norm = e.norm();
        if norm.is_finite() && norm > 0.0 {
            matrices.push(e / norm);
        }
    }
    matrices
}

/// Multiplication by `x` on the basis `x^2, xy, y^2, xz, yz, z^2, x, y, z, 1`.
fn action_matrix(basis: &[Matrix3<f64>; 4]) -> Option<SMatrix<f64, 10, 10>> {
    let entry = |i: usize, j: usize| {
        let mut p: Cubic = [0.0; 20];
        for (k, b) in basis.iter().enumerate() {
            p[16 + k] = b[(i, j)];
        }
        p
    };
    let e: [[Cubic; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)));
    let mut squared = [[[0.0; 20]; 3]; 3];
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                add_product(&mut squared[i][j], 1.0, &e[i][k], 16, &e[j][k], 16);
            }
        }
    }
    let trace: Cubic =
        std::array::from_fn(|m| squared[0][0][m] + squared[1][1][m] + squared[2][2][m]);
    let mut rows: [Cubic; 10] = [[0.0; 20]; 10];
    // 2 E E^T E - trace(E E^T) E = 0
    for i in 0..3 {
        for j in 0..3 {
            let row = &mut rows[3 * i + j];
            for k in 0..3 {
                add_product(row, 2.0, &squared[i][k], 10, &e[k][j], 16);
            }
            add_product(row, -1.0, &trace, 10, &e[i][j], 16);
        }
    }
    // det E = 0
    for (a, b, c) in [(0, 1, 2), (1, 2, 0), (2, 0, 1)] {
        let mut minor = [0.0; 20];
        add_product(&mut minor, 1.0, &e[1][b], 16, &e[2][c], 16);
        add_product(&mut minor, -1.0, &e[1][c], 16, &e[2][b], 16);
        add_product(&mut rows[9], 1.0, &minor, 10, &e[0][a], 16);
    }
    eliminate(&mut rows)?;
    let reduced = |row: usize| std::array::from_fn::<f64, 10, _>(|j| -rows[row][10 + j]);
    let mut action = SMatrix::<f64, 10, 10>::zeros();
    for (to, from) in [(0, 0), (1, 1), (2, 2), (3, 4), (4, 5), (5, 7)] {
        for (j, value) in reduced(from).into_iter().enumerate() {
            action[(to, j)] = value;
        }
    }
    for (to, from) in [(6, 0), (7, 1), (8, 3), (9, 6)] {
        action[(to, from)] = 1.0;
    }
    Some(action)
}

/// Gauss-Jordan with row pivoting on the first ten columns.
fn eliminate(rows: &mut [Cubic; 10]) -> Option<()> {
    for column in 0..10 {
        let pivot = (column..10)
            .max_by(|&a, &b| rows[a][column].abs().total_cmp(&rows[b][column].abs()))?;
        rows.swap(column, pivot);
        let scale = rows[column][column];
        if scale.abs() < 1e-14 {
            return None;
        }
        for j in column..20 {
            rows[column][j] /= scale;
        }
        let reference = rows[column];
        for (i, row) in rows.iter_mut().enumerate() {
            if i != column && row[column] != 0.0 {
                let factor = row[column];
                for j in column..20 {
                    row[j] -= factor * reference[j];
                }
            }
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::{essential_matrices, relate};
    use m4_core::{
        CounterRng, Se3, exp_so3, hat, log_so3,
        nalgebra::{Matrix3, Vector3},
    };

    #[test]
    fn motion_is_found_among_moving_points() {
        let focal = 400.0;
        let truth = Se3 {
            rotation: exp_so3(&Vector3::new(0.03, -0.08, 0.02)),
            translation: Vector3::new(0.5, 0.1, -0.1),
        };
        let mut rng = CounterRng::new(1, 0, 0);
        let project = |p: Vector3<f64>| [focal * p.x / p.z, focal * p.y / p.z];
        let matches: Vec<_> = (0..300)
            .map(|i| {
                let p = Vector3::new(
                    2.0 * rng.normal(),
                    1.5 * rng.normal(),
                    4.0 + 4.0 * rng.uniform(),
                );
                let mut q = truth.transform(&p);
                if i % 4 == 0 {
                    q += Vector3::new(0.3 * rng.normal(), 0.3 * rng.normal(), 0.3 * rng.normal());
                }
                let b = project(q);
                (
                    project(p),
                    [b[0] + 0.3 * rng.normal(), b[1] + 0.3 * rng.normal()],
                )
            })
            .collect();
        let relation = relate(&matches, focal, 0, 0).expect("a motion");
        let turn = log_so3(&(relation.motion.rotation * truth.rotation.transpose())).norm();
        let angle = relation
            .motion
            .translation
            .dot(&truth.translation.normalize())
            .acos();
        assert!(turn < 0.01 && angle < 0.05, "{turn} {angle}");
        assert!(
            relation.inliers.len() > 220 && relation.score > 0.6,
            "{} {}",
            relation.inliers.len(),
            relation.score
        );
        assert!(relate(&matches[..7], focal, 0, 0).is_none());
    }

    #[test]
    fn the_true_matrix_is_among_the_solutions() {
        let mut missed = 0;
        for seed in 0..50 {
            let mut rng = CounterRng::new(seed, 0, 0);
            let mut random = |s: f64| Vector3::from_fn(|_, _| s * rng.normal());
            let (rotation, translation) = (exp_so3(&random(0.2)), random(1.0).normalize());
            let truth = (hat(&translation) * rotation).normalize();
            let points: [Vector3<f64>; 5] =
                std::array::from_fn(|_| random(1.0) + Vector3::new(0.0, 0.0, 6.0));
            let first = points.map(|p| p / p.z);
            let second = points.map(|p| rotation * p + translation).map(|p| p / p.z);
            let matrices = essential_matrices(&first, &second);
            let error = |e: &Matrix3<f64>| (e - truth).norm().min((e + truth).norm());
            let best = matrices.iter().map(error).fold(f64::INFINITY, f64::min);
            missed += usize::from(best > 1e-5);
            for e in &matrices {
                for k in 0..5 {
                    assert!(second[k].dot(&(e * first[k])).abs() < 1e-7);
                }
            }
        }
        assert!(
            missed <= 1,
            "{missed} of 50 samples without the true matrix"
        );
    }

    #[test]
    fn equal_points_give_nothing_wrong() {
        let same = [Vector3::new(0.1, 0.2, 1.0); 5];
        for e in essential_matrices(&same, &same) {
            assert!(e.iter().all(|v| v.is_finite()));
        }
    }
}
