//! Central differences of functions with discontinuities.

/// Result of one evaluation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Side {
    /// The loss.
    pub value: f64,
    /// A hash of every discrete decision on the way (sort order, cut-offs, clamps); a constant where
    /// there are none.
    pub decisions: u64,
}

impl From<f64> for Side {
    fn from(value: f64) -> Self {
        Self { value, decisions: 0 }
    }
}

/// The differences, and where they cannot be trusted.
#[derive(Debug, Clone, PartialEq)]
pub struct Differences {
    /// One per parameter.
    pub gradient: Vec<f64>,
    /// Parameters whose decisions differ on the two sides however small the step: their entry means
    /// nothing.
    pub jumps: Vec<usize>,
}

impl Differences {
    /// `(got, want)` without the entries at jumps.
    #[must_use]
    pub fn trusted(&self, got: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let keep = (0..self.gradient.len()).filter(|i| !self.jumps.contains(i));
        keep.map(|i| (got[i], self.gradient[i])).unzip()
    }
}

/// `(f(x + h e_i) - f(x - h e_i)) / 2h` for every `i`. Where the decisions of the two sides differ, `h`
/// shrinks eightfold, three times at most.
pub fn central_differences<S: Into<Side>>(x: &[f64], step: f64, mut f: impl FnMut(&[f64]) -> S) -> Differences {
    let mut at = x.to_vec();
    let mut out = Differences { gradient: vec![0.0; x.len()], jumps: Vec::new() };
    for i in 0..x.len() {
        let mut h = step;
        for attempt in 0..4 {
            at[i] = x[i] + h;
            let up: Side = f(&at).into();
            at[i] = x[i] - h;
            let down: Side = f(&at).into();
            at[i] = x[i];
            out.gradient[i] = (up.value - down.value) / (2.0 * h);
            if up.decisions == down.decisions {
                break;
            }
            if attempt == 3 {
                out.jumps.push(i);
            }
            h /= 8.0;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::{Side, central_differences};

    #[test]
    fn a_step_shrinks_until_the_decision_is_the_same() {
        // jumps by 1 at x = 0.5e-3
        let f = |x: &[f64]| Side {
            value: x[0] * x[0] + if x[0] > 0.5e-3 { 1.0 } else { 0.0 },
            decisions: u64::from(x[0] > 0.5e-3),
        };
        let d = central_differences(&[0.0], 1e-3, f);
        assert!(d.gradient[0].abs() < 1e-9 && d.jumps.is_empty());
        let d = central_differences(&[0.5e-3], 1e-3, f);
        assert_eq!(d.jumps, [0]);
        assert!(d.trusted(&[7.0]).0.is_empty());
    }
}
