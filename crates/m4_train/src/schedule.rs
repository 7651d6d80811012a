//! The frame of an iteration, the learning rate per column, and the purposes of random numbers.

use crate::{config::RateConfig, scale::SceneScale};
use m4_core::{Column, CounterRng, SplatLayout};
use m4_kernels::adam::nodes::NodeRates;

/// `exp((1 - x) ln a + x ln b)`, log-linear from `a` to `b` with `x` in 0..1
/// (docs/spec/optimiser.md 3); linear when one of them is 0.
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

/// Period of the first harmonic of time, frames: the length of the video
/// (docs/spec/optimiser.md 1.8).
pub(crate) fn period(time_frames: usize) -> f32 {
    (time_frames.max(2) - 1) as f32
}

/// Purposes of random numbers in this crate: streams never overlap.
pub(crate) mod purpose {
    pub const SHUFFLE: u64 = 0x5455_0001;
    pub const DENSIFY_FRAMES: u64 = 0x5455_0003;
    /// Plus the iteration shifted by 8 bits.
    pub const SPLIT: u64 = 0x5455_0005;
}

/// Every frame once an epoch, in an order drawn again for each.
#[derive(Debug, Clone)]
pub(crate) struct Picker {
    seed: u64,
    frames: usize,
    order: Vec<usize>,
    epoch: Option<usize>,
}

impl Picker {
    pub fn new(seed: u64, frames: usize) -> Self {
        Self {
            seed,
            frames,
            order: Vec::new(),
            epoch: None,
        }
    }

    /// The frame of `iteration`.
    pub fn pick(&mut self, iteration: usize) -> usize {
        let n = self.frames;
        let epoch = iteration / n;
        if self.epoch != Some(epoch) {
            self.order = CounterRng::new(self.seed, purpose::SHUFFLE, epoch as u64).sample(n, n);
            self.epoch = Some(epoch);
        }
        self.order[iteration % n]
    }
}

/// What rates depend on beside the settings.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RateBasis {
    /// Median of the first standard deviations in time, frames; 1 without dynamic splats.
    pub time_sd: f32,
    /// Frames of the video.
    pub time_frames: usize,
}

/// Change of colour a frame, in units of the rate of constant colours (measured:
/// docs/decisions/0022).
const TREND: f32 = 0.2;
/// Positions of nodes, in units of the rate of means: a step of a node is the mean of what many
/// splats ask for (measured: docs/decisions/0022).
const NODE_POSITION: f32 = 10.0;
/// Turns of nodes, radians (measured: docs/decisions/0022).
const NODE_TURN: f32 = 0.015;

/// The rates of nodes at `x` of the run (0..1).
pub(crate) fn node_rates(config: &RateConfig, scale: &SceneScale, x: f32) -> NodeRates {
    let fall = log_linear(config.position, config.position_end, x);
    NodeRates {
        position: NODE_POSITION * fall * scale.extent,
        turn: NODE_TURN * log_linear(1.0, config.other_end, x),
    }
}

/// The rates at `x` of the run (0..1), in the order of [`m4_core::Splats::columns`].
pub(crate) fn rates(
    config: &RateConfig,
    layout: SplatLayout,
    scale: &SceneScale,
    basis: RateBasis,
    x: f32,
) -> Vec<f32> {
    let unit = scale.extent;
    let fall = log_linear(config.position, config.position_end, x);
    let other = log_linear(1.0, config.other_end, x);
    let velocity = if config.position > 0.0 {
        config.velocity * fall / config.position
    } else {
        config.velocity
    };
    let time_mean = if config.time_mean_reference > 0.0 {
        let last = basis.time_frames.max(2) - 1;
        config.position * unit * last as f32 / config.time_mean_reference
    } else {
        0.0
    };
    let mut out = vec![0.0; layout.columns()];
    let mut set = |column, rate: f32| out[layout.range(column)].fill(rate);
    set(Column::Mean, fall * unit);
    set(Column::LogScale, config.scale * other);
    set(Column::Quat, config.rotation * other);
    set(Column::Opacity, config.opacity * other);
    set(Column::Colour, config.colour_harmonics * other);
    set(Column::TimeMean, time_mean);
    set(Column::Trend, TREND * config.colour * other);
    set(Column::LogTimeSd, config.time_sd * other);
    set(Column::Velocity, velocity * unit / basis.time_sd.max(1e-3));
    let constant = layout.column(Column::Colour);
    out[constant..constant + 3].fill(config.colour * other);
    out
}

#[cfg(test)]
mod tests {
    use super::{Picker, RateBasis, log_linear, rates};
    use crate::{config::RateConfig, scale::SceneScale};
    use m4_core::{Column, SplatLayout};

    #[test]
    fn rates_fall_log_linearly() {
        assert!((log_linear(1e-2, 1e-4, 0.5) - 1e-3).abs() < 1e-9);
        assert_eq!(log_linear(0.0, 0.0, 0.3), 0.0);
        assert!((log_linear(0.1, 0.0, 0.25) - 0.075).abs() < 1e-7);
        assert!((log_linear(0.1, 0.01, 7.0) - 0.01).abs() < 1e-8);
    }

    #[test]
    fn an_epoch_sees_every_frame_once() {
        let mut picker = Picker::new(3, 7);
        for epoch in 0..4 {
            let mut picks: Vec<usize> = (0..7).map(|i| picker.pick(7 * epoch + i)).collect();
            picks.sort_unstable();
            assert!(picks.iter().copied().eq(0..7));
        }
        // the order is that of the iteration, not of the calls
        let mut fresh = Picker::new(3, 7);
        assert_eq!(fresh.pick(25), picker.pick(25));
        assert_eq!(fresh.pick(8), picker.pick(8));
    }

    #[test]
    fn columns_get_their_rates() {
        let layout = SplatLayout {
            isotropic: false,
            sh_degree: 1,
            time_degree: 0,
        };
        let scale = SceneScale {
            one_centre: false,
            extent: 2.0,
            median_depth: 5.0,
            focal_px: 100.0,
            centres: vec![[0.0; 3]],
        };
        let basis = RateBasis {
            time_sd: 2.0,
            time_frames: 31,
        };
        let at = |config: &RateConfig, x, column| {
            rates(config, layout, &scale, basis, x)[layout.column(column)]
        };
        let fast = RateConfig::default();
        assert!((at(&fast, 0.0, Column::Mean) - 6e-4).abs() < 1e-8);
        assert!((at(&fast, 1.0, Column::Mean) - 1.6e-5).abs() < 1e-9);
        assert!((at(&fast, 1.0, Column::Velocity) - 1.6e-4 * 8e-6 / 3e-4).abs() < 1e-9);
        let half = 0.05 * 0.05f32.sqrt();
        assert!((at(&fast, 0.5, Column::Opacity) - half).abs() < 1e-6);
        let colour = rates(&fast, layout, &scale, basis, 0.0);
        let first = layout.column(Column::Colour);
        assert!(
            colour[first..]
                .iter()
                .take(12)
                .all(|rate| (rate - 0.02).abs() < 1e-8)
        );
        let faithful = RateConfig::faithful();
        let colour = rates(&faithful, layout, &scale, basis, 1.0);
        assert!(
            (colour[first + 2] - 2.5e-3).abs() < 1e-9
                && (colour[first + 3] - 1.25e-4).abs() < 1e-10
        );
        assert_eq!(at(&faithful, 0.5, Column::Velocity), 0.0);
        assert!((at(&faithful, 0.9, Column::TimeMean) - 1.6e-4 * 2.0 * 10.0).abs() < 1e-8);
    }
}
