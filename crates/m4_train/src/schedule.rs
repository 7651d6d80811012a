//! What changes over a run, as functions of the iteration alone.

use crate::config::{LossConfig, ResolutionConfig};

/// `exp((1 - x) ln a + x ln b)`, log-linear from `a` to `b` with `x` in 0..1 (section 3); linear when
/// one of them is 0.
pub(crate) fn log_linear(a: f32, b: f32, x: f32) -> f32 {
    let x = x.clamp(0.0, 1.0);
    if a > 0.0 && b > 0.0 {
        ((1.0 - x) * a.ln() + x * b.ln()).exp()
    } else {
        (1.0 - x) * a + x * b
    }
}

/// How far iteration `i` of `n` is, 0..1.
pub(crate) fn progress(i: usize, n: usize) -> f32 {
    (i as f64 / n.max(1) as f64).min(1.0) as f32
}

/// By how much frames of `width` x `height` are made smaller: 1, 2 or 4.
pub(crate) fn downscale(config: &ResolutionConfig, x: f32, width: usize, height: usize) -> usize {
    let wanted = if x < config.quarter_until {
        4
    } else if x < config.half_until {
        2
    } else {
        1
    };
    let side = width.min(height);
    [4, 2]
        .into_iter()
        .find(|&f| f <= wanted && side / f >= config.min_side_px)
        .unwrap_or(1)
}

/// Weight of the depth loss.
pub(crate) fn depth_weight(config: &LossConfig, x: f32) -> f32 {
    log_linear(config.depth_weight, config.depth_weight_end, x)
}

#[cfg(test)]
mod tests {
    use super::{downscale, log_linear};
    use crate::config::ResolutionConfig;

    #[test]
    fn rates_fall_log_linearly() {
        assert!((log_linear(1e-2, 1e-4, 0.5) - 1e-3).abs() < 1e-9);
        assert_eq!(log_linear(0.0, 0.0, 0.3), 0.0);
        assert!((log_linear(0.1, 0.0, 0.25) - 0.075).abs() < 1e-7);
        assert!((log_linear(0.1, 0.01, 7.0) - 0.01).abs() < 1e-8);
    }

    #[test]
    fn small_frames_are_not_made_smaller() {
        let config = ResolutionConfig {
            quarter_until: 0.1,
            half_until: 0.4,
            min_side_px: 64,
        };
        assert_eq!(downscale(&config, 0.05, 480, 360), 4);
        assert_eq!(downscale(&config, 0.05, 300, 200), 2);
        assert_eq!(downscale(&config, 0.2, 480, 360), 2);
        assert_eq!(downscale(&config, 0.5, 480, 360), 1);
        assert_eq!(downscale(&config, 0.05, 100, 80), 1);
    }
}
