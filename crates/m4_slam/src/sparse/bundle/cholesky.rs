//! Cholesky factorisation of a symmetric matrix with an envelope.

/// The lower triangle, row by row, each row of full length `n`; factorised in place by [`Lower::factorise`].
#[derive(Debug, Clone)]
pub(super) struct Lower {
    n: usize,
    data: Vec<f64>,
    /// First column of each row that is not zero.
    first: Vec<usize>,
}

impl Lower {
    /// Takes `data`, `[n][n]`, of which only the lower triangle is read.
    pub fn new(n: usize, data: Vec<f64>) -> Self {
        let first = (0..n)
            .map(|i| (0..i).find(|&j| data[i * n + j] != 0.0).unwrap_or(i))
            .collect();
        Self { n, data, first }
    }

    /// Turns the matrix into its factor; `None` when it is not positive definite.
    pub fn factorise(mut self) -> Option<Self> {
        let n = self.n;
        for i in 0..n {
            let (above, rest) = self.data.split_at_mut(i * n);
            let row = &mut rest[..n];
            for j in self.first[i]..i {
                let from = self.first[i].max(self.first[j]);
                let other = &above[j * n..j * n + n];
                let sum = dot(&row[from..j], &other[from..j]);
                row[j] = (row[j] - sum) / other[j];
            }
            let from = self.first[i];
            let pivot = row[i] - dot(&row[from..i], &row[from..i]);
            if !(pivot > 0.0 && pivot.is_finite()) {
                return None;
            }
            row[i] = pivot.sqrt();
        }
        Some(self)
    }

    /// Solves with the factor.
    pub fn solve(&self, b: &[f64]) -> Vec<f64> {
        let n = self.n;
        let mut x = b.to_vec();
        for i in 0..n {
            let from = self.first[i];
            let row = &self.data[i * n..i * n + n];
            x[i] = (x[i] - dot(&row[from..i], &x[from..i])) / row[i];
        }
        for i in (0..n).rev() {
            let row = &self.data[i * n..i * n + n];
            x[i] /= row[i];
            let xi = x[i];
            for j in self.first[i]..i {
                x[j] -= row[j] * xi;
            }
        }
        x
    }
}

/// Inner product with eight partial sums, which the compiler keeps in one register.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0_f64; 8];
    let (a_chunks, b_chunks) = (a.chunks_exact(8), b.chunks_exact(8));
    let tail: f64 = a_chunks
        .remainder()
        .iter()
        .zip(b_chunks.remainder())
        .map(|(x, y)| x * y)
        .sum();
    for (x, y) in a_chunks.zip(b_chunks) {
        for k in 0..8 {
            sums[k] += x[k] * y[k];
        }
    }
    sums.iter().sum::<f64>() + tail
}

#[cfg(test)]
mod tests {
    use super::Lower;

    #[test]
    fn a_system_with_an_envelope_is_solved() {
        let n = 23;
        let mut a = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                if i - j < 6 || i == n - 1 {
                    let value = if i == j {
                        20.0 + i as f64
                    } else {
                        ((i * 7 + j * 3) as f64).sin()
                    };
                    (a[i * n + j], a[j * n + i]) = (value, value);
                }
            }
        }
        let want: Vec<f64> = (0..n).map(|i| (i as f64).cos()).collect();
        let b: Vec<f64> = (0..n).map(|i| (0..n).map(|j| a[i * n + j] * want[j]).sum()).collect();
        let got = Lower::new(n, a.clone())
            .factorise()
            .expect("positive definite")
            .solve(&b);
        assert!(got.iter().zip(&want).all(|(x, y)| (x - y).abs() < 1e-10));
        a[0] = -1.0;
        assert!(Lower::new(n, a).factorise().is_none());
    }
}
