//! The values that change during training, as functions of the iteration alone.

/// `exp((1 - x) ln a + x ln b)`, log-linear from `a` to `b` with `x` in 0..1 (docs/spec/optimiser.md 3);
/// linear when one of them is 0.
pub(crate) fn log_linear(a: f32, b: f32, x: f32) -> f32 {
    let x = x.clamp(0.0, 1.0);
    if a > 0.0 && b > 0.0 { ((1.0 - x) * a.ln() + x * b.ln()).exp() } else { (1.0 - x) * a + x * b }
}

/// How far iteration `i` of `n` is, 0..1.
pub(crate) fn progress(i: usize, n: usize) -> f32 {
    (i as f64 / n.max(1) as f64).min(1.0) as f32
}

#[cfg(test)]
mod tests {
    use super::log_linear;

    #[test]
    fn rates_fall_log_linearly() {
        assert!((log_linear(1e-2, 1e-4, 0.5) - 1e-3).abs() < 1e-9);
        assert_eq!(log_linear(0.0, 0.0, 0.3), 0.0);
        assert!((log_linear(0.1, 0.0, 0.25) - 0.075).abs() < 1e-7);
        assert!((log_linear(0.1, 0.01, 7.0) - 0.01).abs() < 1e-8);
    }
}
