//! Essential matrices through five matches.
//!
//! Nistér's problem (2004) in the form of Stewénius, Engels and Nistér (2006): the four-dimensional
//! null space of the epipolar equations, ten cubic constraints on it, and the eigenvectors of the
//! matrix of "multiplication by x" in the quotient ring.

use m4_core::nalgebra::{Matrix3, SMatrix, Schur, Vector3};

/// Exponents of `x, y, z` of the twenty monomials: ten of degree 3, then the basis of the quotient.
const MONOMIALS: [[u8; 3]; 20] = [
    [3, 0, 0],
    [2, 1, 0],
    [1, 2, 0],
    [0, 3, 0],
    [2, 0, 1],
    [1, 1, 1],
    [0, 2, 1],
    [1, 0, 2],
    [0, 1, 2],
    [0, 0, 3],
    [2, 0, 0],
    [1, 1, 0],
    [0, 2, 0],
    [1, 0, 1],
    [0, 1, 1],
    [0, 0, 2],
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
    [0, 0, 0],
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
                let (a, b, c) = (MONOMIALS[i], MONOMIALS[j], MONOMIALS[k]);
                if a[0] + b[0] == c[0] && a[1] + b[1] == c[1] && a[2] + b[2] == c[2] {
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

/// The essential matrices `E` with `second^T E first = 0` for five pairs of rays `(x, y, 1)`; at most
/// ten. Empty for degenerate samples.
pub(crate) fn essential_matrices(first: &[Vector3<f64>; 5], second: &[Vector3<f64>; 5]) -> Vec<Matrix3<f64>> {
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
    let basis: [Matrix3<f64>; 4] = std::array::from_fn(|b| Matrix3::from_fn(|i, j| v_t[(5 + b, 3 * i + j)]));
    let Some(action) = action_matrix(&basis) else {
        return Vec::new();
    };
    let Some(schur) = Schur::try_new(action, 1e-12, 300) else {
        return Vec::new();
    };
    let mut found = Vec::new();
    for value in schur.complex_eigenvalues().iter() {
        if value.im.abs() > 1e-8 * (1.0 + value.re.abs()) {
            continue;
        }
        // One step of inverse iteration, slightly off the eigenvalue, gives the eigenvector.
        let shifted = action - SMatrix::<f64, 10, 10>::identity() * (value.re + 1e-9 * (1.0 + value.re.abs()));
        let Some(v) = shifted.lu().solve(&SMatrix::<f64, 10, 1>::repeat(1.0)) else {
            continue;
        };
        let e = (basis[0] * v[6] + basis[1] * v[7] + basis[2] * v[8]) / v[9] + basis[3];
        let norm = e.norm();
        if norm.is_finite() && norm > 0.0 {
            found.push(e / norm);
        }
    }
    found
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
    let trace: Cubic = std::array::from_fn(|m| squared[0][0][m] + squared[1][1][m] + squared[2][2][m]);
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
        let pivot = (column..10).max_by(|&a, &b| rows[a][column].abs().total_cmp(&rows[b][column].abs()))?;
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
    use super::essential_matrices;
    use m4_core::{
        CounterRng, exp_so3, hat,
        nalgebra::{Matrix3, Vector3},
    };

    #[test]
    fn the_true_matrix_is_among_the_solutions() {
        let mut missed = 0;
        for seed in 0..50 {
            let mut rng = CounterRng::new(seed, 0, 0);
            let mut random = |s: f64| Vector3::from_fn(|_, _| s * rng.normal());
            let (rotation, translation) = (exp_so3(&random(0.2)), random(1.0).normalize());
            let truth = (hat(&translation) * rotation).normalize();
            let points: [Vector3<f64>; 5] = std::array::from_fn(|_| random(1.0) + Vector3::new(0.0, 0.0, 6.0));
            let first = points.map(|p| p / p.z);
            let second = points.map(|p| rotation * p + translation).map(|p| p / p.z);
            let found = essential_matrices(&first, &second);
            let error = |e: &Matrix3<f64>| (e - truth).norm().min((e + truth).norm());
            let best = found.iter().map(error).fold(f64::INFINITY, f64::min);
            missed += usize::from(best > 1e-5);
            for e in &found {
                for k in 0..5 {
                    assert!(second[k].dot(&(e * first[k])).abs() < 1e-7);
                }
            }
        }
        assert!(missed <= 1, "{missed} of 50 samples without the true matrix");
    }

    #[test]
    fn equal_points_give_nothing_wrong() {
        let same = [Vector3::new(0.1, 0.2, 1.0); 5];
        for e in essential_matrices(&same, &same) {
            assert!(e.iter().all(|v| v.is_finite()));
        }
    }
}
