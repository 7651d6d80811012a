//! Comparisons with bounds that a zero gradient cannot satisfy, and central differences of
//! functions with discontinuities.

/// Agreement of two vectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// Largest difference over the largest component of `want`.
    pub largest: f64,
    /// `|got - want| / |want|`.
    pub relative_l2: f64,
    /// Cosine of the angle between the two.
    pub cosine: f64,
    /// Index of the largest difference.
    pub at: usize,
}

impl Agreement {
    /// Compares `got` with `want`; two vectors of zeros agree fully, zeros and anything else not at
    /// all. A number that is not finite never agrees.
    pub fn of(got: &[f64], want: &[f64]) -> Self {
        assert_eq!(got.len(), want.len(), "two vectors of different lengths");
        let (mut largest, mut at, mut scale) = (0.0f64, 0, 0.0f64);
        let (mut square, mut got_square, mut want_square, mut dot) = (0.0, 0.0, 0.0, 0.0);
        for (i, (&g, &w)) in got.iter().zip(want).enumerate() {
            let d = if g.is_finite() {
                (g - w).abs()
            } else {
                f64::INFINITY
            };
            if d > largest {
                (largest, at) = (d, i);
            }
            scale = scale.max(w.abs());
            square += d * d;
            got_square += g * g;
            want_square += w * w;
            dot += g * w;
        }
        if got_square == 0.0 && want_square == 0.0 {
            return Self {
                largest: 0.0,
                relative_l2: 0.0,
                cosine: 1.0,
                at,
            };
        }
        let cosine = dot / (got_square * want_square).sqrt();
        Self {
            largest: largest / scale,
            relative_l2: (square / want_square).sqrt(),
            cosine: if cosine.is_finite() { cosine } else { 0.0 },
            at,
        }
    }
}

/// Fails unless every entry of `got` is within `tolerance` times the largest component of `want`,
/// the relative L2 distance is at most twice `tolerance` and the cosine at least `1 - tolerance`.
pub fn assert_gradient(what: &str, got: &[f64], want: &[f64], tolerance: f64) {
    let a = Agreement::of(got, want);
    assert!(
        a.largest <= tolerance && a.relative_l2 <= 2.0 * tolerance && a.cosine >= 1.0 - tolerance,
        "{what}: entry {} is {:e} where {:e} was expected; off by {:.1e} of the largest component, relative L2 {:.1e}, \
         cosine {:.9}; at most {tolerance:.1e} is allowed",
        a.at,
        got[a.at],
        want[a.at],
        a.largest,
        a.relative_l2,
        a.cosine,
    );
}

/// Tolerances for an image of a model with steps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flips {
    /// Largest difference of a value that is not at a step.
    pub tolerance: f64,
    /// Largest difference at a step: one contribution more or less.
    pub step: f64,
    /// Share of the values that may lie at a step, 0..1.
    pub share: f64,
}

/// Fails unless `got` equals `want` within `bounds`.
pub fn assert_image(what: &str, got: &[f32], want: &[f64], bounds: Flips) {
    assert_eq!(got.len(), want.len(), "{what}: images of different sizes");
    let mut flips = 0;
    for (i, (&g, &w)) in got.iter().zip(want).enumerate() {
        let d = (f64::from(g) - w).abs();
        // written so that a NaN fails
        assert!(
            d <= bounds.step,
            "{what}: value {i} is {g} where {w} was expected"
        );
        flips += usize::from(d > bounds.tolerance);
    }
    let allowed = (bounds.share * want.len() as f64).ceil() as usize;
    assert!(
        flips <= allowed,
        "{what}: {flips} of {} values differ by more than {:e}, {allowed} may",
        want.len(),
        bounds.tolerance
    );
}

/// Result of one evaluation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Side {
    /// The loss.
    pub value: f64,
    /// A hash of every discrete decision on the way (sort order, cut-offs, clamps); a constant
    /// where there are none.
    pub decisions: u64,
}

impl From<f64> for Side {
    fn from(value: f64) -> Self {
        Self {
            value,
            decisions: 0,
        }
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

/// `(f(x + h e_i) - f(x - h e_i)) / 2h` for every `i`. Where the decisions of the two sides differ,
/// `h` shrinks eightfold, three times at most.
pub fn central_differences<S: Into<Side>>(
    x: &[f64],
    step: f64,
    mut f: impl FnMut(&[f64]) -> S,
) -> Differences {
    let mut at = x.to_vec();
    let mut out = Differences {
        gradient: vec![0.0; x.len()],
        jumps: Vec::new(),
    };
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
    use super::{Agreement, Flips, Side, assert_gradient, assert_image, central_differences};

    #[test]
    fn zeros_do_not_agree_with_a_gradient() {
        let a = Agreement::of(&[0.0; 3], &[1e-9, 2e-9, 0.0]);
        assert!(a.largest == 1.0 && a.cosine == 0.0 && a.relative_l2 == 1.0);
        assert_eq!(Agreement::of(&[0.0; 3], &[0.0; 3]).largest, 0.0);
        assert!(Agreement::of(&[f64::NAN, 1.0], &[0.0, 1.0]).largest > 1.0);
    }

    #[test]
    #[should_panic(expected = "entry 1")]
    fn one_wrong_entry_is_found() {
        assert_gradient("test", &[1.0, 2.1, 3.0], &[1.0, 2.0, 3.0], 1e-3);
    }

    #[test]
    #[should_panic(expected = "value 0")]
    fn a_nan_pixel_is_found() {
        let bounds = Flips {
            tolerance: 1.0,
            step: 1.0,
            share: 1.0,
        };
        assert_image("test", &[f32::NAN], &[0.0], bounds);
    }

    #[test]
    fn a_few_flips_are_let_through() {
        let bounds = Flips {
            tolerance: 1e-6,
            step: 0.01,
            share: 0.25,
        };
        assert_image("test", &[0.0, 0.0, 0.005, 0.0], &[0.0; 4], bounds);
    }

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
    }
}
