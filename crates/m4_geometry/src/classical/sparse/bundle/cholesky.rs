//! Cholesky factorisation of a symmetric matrix with an envelope.

/// Which entries of the lower triangle may differ from zero: those from [`Self::first`] of a row to its diagonal. A long
/// clip has thousands of rows and hardly any that reach far back.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Envelope {
    first: Vec<usize>,
    /// Where a row begins in the data, and one more for the end.
    begin: Vec<usize>,
}

impl Envelope {
    /// Rows that begin at these columns, none beyond its diagonal.
    pub fn new(first: Vec<usize>) -> Self {
        let mut begin = Vec::with_capacity(first.len() + 1);
        begin.push(0);
        let mut end = 0;
        for (i, &first) in first.iter().enumerate() {
            end += i + 1 - first.min(i);
            begin.push(end);
        }
        Self { first, begin }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.first.len()
    }

    /// Number of entries kept.
    pub fn entries(&self) -> usize {
        self.begin[self.first.len()]
    }

    /// Where the entry of a row and a column within the envelope lies.
    pub fn at(&self, row: usize, column: usize) -> usize {
        self.begin[row] + column - self.first[row]
    }
}

/// The lower triangle within an envelope, row by row; factorised in place by [`Lower::factorise`].
#[derive(Debug, Clone)]
pub(super) struct Lower<'a> {
    envelope: &'a Envelope,
    data: Vec<f64>,
}

impl<'a> Lower<'a> {
    /// Takes the entries of the envelope.
    pub fn new(envelope: &'a Envelope, data: Vec<f64>) -> Self {
        Self { envelope, data }
    }

    /// Turns the matrix into its factor; `None` when it is not positive definite.
    pub fn factorise(mut self) -> Option<Self> {
        let Envelope { first, begin } = self.envelope;
        for i in 0..first.len() {
            let (above, rest) = self.data.split_at_mut(begin[i]);
            // Entry `j` of row `i` is `row[j - fi]`.
            let (fi, row) = (first[i], &mut rest[..begin[i + 1] - begin[i]]);
            for j in fi..i {
                let (fj, other) = (first[j], &above[begin[j]..begin[j + 1]]);
                let from = fi.max(fj);
                let sum = dot(&row[from - fi..j - fi], &other[from - fj..j - fj]);
                row[j - fi] = (row[j - fi] - sum) / other[j - fj];
            }
            let (before, diagonal) = row.split_at_mut(i - fi);
            let pivot = diagonal[0] - dot(before, before);
            if !(pivot > 0.0 && pivot.is_finite()) {
                return None;
            }
            diagonal[0] = pivot.sqrt();
        }
        Some(self)
    }

    /// Solves with the factor.
    pub fn solve(&self, b: &[f64]) -> Vec<f64> {
        let Envelope { first, begin } = self.envelope;
        let mut x = b.to_vec();
        for i in 0..first.len() {
            let (before, diagonal) = self.data[begin[i]..begin[i + 1]].split_at(i - first[i]);
            x[i] = (x[i] - dot(before, &x[first[i]..i])) / diagonal[0];
        }
        for i in (0..first.len()).rev() {
            let (before, diagonal) = self.data[begin[i]..begin[i + 1]].split_at(i - first[i]);
            x[i] /= diagonal[0];
            let xi = x[i];
            for (x, l) in x[first[i]..i].iter_mut().zip(before) {
                *x -= l * xi;
            }
        }
        x
    }
}

/// Inner product with eight partial sums, which the compiler keeps in one register.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0_f64; 8];
    let (a_chunks, b_chunks) = (a.chunks_exact(8), b.chunks_exact(8));
    let tail: f64 = a_chunks.remainder().iter().zip(b_chunks.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in a_chunks.zip(b_chunks) {
        for k in 0..8 {
            sums[k] += x[k] * y[k];
        }
    }
    sums.iter().sum::<f64>() + tail
}

#[cfg(test)]
mod tests {
    use super::{Envelope, Lower};

    #[test]
    fn a_system_with_an_envelope_is_solved() {
        let n = 23;
        let mut a = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                if i - j < 6 || i == n - 1 {
                    let value = if i == j { 20.0 + i as f64 } else { ((i * 7 + j * 3) as f64).sin() };
                    (a[i * n + j], a[j * n + i]) = (value, value);
                }
            }
        }
        let want: Vec<f64> = (0..n).map(|i| (i as f64).cos()).collect();
        let b: Vec<f64> = (0..n).map(|i| (0..n).map(|j| a[i * n + j] * want[j]).sum()).collect();
        let first = |i: usize| if i == n - 1 { 0 } else { i.saturating_sub(5) };
        let envelope = Envelope::new((0..n).map(first).collect());
        assert_eq!((envelope.rows(), envelope.entries()), (n, 15 + 17 * 6 + n));
        let within =
            |a: &[f64]| -> Vec<f64> { (0..n).flat_map(|i| a[i * n + first(i)..=i * n + i].to_vec()).collect() };
        assert_eq!(within(&a)[envelope.at(10, 7)], a[10 * n + 7]);
        let got = Lower::new(&envelope, within(&a)).factorise().expect("positive definite").solve(&b);
        assert!(got.iter().zip(&want).all(|(x, y)| (x - y).abs() < 1e-10));
        a[0] = -1.0;
        assert!(Lower::new(&envelope, within(&a)).factorise().is_none());
    }
}
