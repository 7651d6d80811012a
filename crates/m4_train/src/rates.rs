//! One learning rate per column.

use crate::{config::RateConfig, scale::SceneScale, schedule::log_linear};
use m4_core::{Column, SplatLayout};

/// What rates depend on beside the settings.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RateBasis {
    /// Median of the first standard deviations in time, frames; 1 without dynamic splats.
    pub time_sd: f32,
    /// Frames of the video.
    pub time_frames: usize,
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
    let velocity = if config.position > 0.0 { config.velocity * fall / config.position } else { config.velocity };
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
    set(Column::Colour, config.colour / 20.0 * other);
    set(Column::TimeMean, time_mean);
    set(Column::LogTimeSd, config.time_sd * other);
    set(Column::Velocity, velocity * unit / basis.time_sd.max(1e-3));
    let constant = layout.column(Column::Colour);
    out[constant..constant + 3].fill(config.colour * other);
    out
}

#[cfg(test)]
mod tests {
    use super::{RateBasis, rates};
    use crate::{config::RateConfig, scale::SceneScale};
    use m4_core::{Column, SplatLayout};

    #[test]
    fn columns_get_their_rates() {
        let layout = SplatLayout { isotropic: false, sh_degree: 1, time_degree: 0 };
        let scale =
            SceneScale { one_centre: false, extent: 2.0, median_depth: 5.0, focal_px: 100.0, centres: vec![[0.0; 3]] };
        let basis = RateBasis { time_sd: 2.0, time_frames: 31 };
        let at = |config: &RateConfig, x, column| rates(config, layout, &scale, basis, x)[layout.column(column)];
        let fast = RateConfig::default();
        assert!((at(&fast, 0.0, Column::Mean) - 6e-4).abs() < 1e-8);
        assert!((at(&fast, 1.0, Column::Mean) - 1.6e-5).abs() < 1e-9);
        assert!((at(&fast, 1.0, Column::Velocity) - 1.6e-4 * 8e-6 / 3e-4).abs() < 1e-9);
        let half = 0.05 * 0.05f32.sqrt();
        assert!((at(&fast, 0.5, Column::Opacity) - half).abs() < 1e-6);
        let colour = rates(&fast, layout, &scale, basis, 0.0);
        let first = layout.column(Column::Colour);
        assert!((colour[first + 2] - 0.02).abs() < 1e-8 && (colour[first + 3] - 1e-3).abs() < 1e-9);
        let faithful = RateConfig::faithful();
        assert_eq!(at(&faithful, 0.5, Column::Velocity), 0.0);
        assert!((at(&faithful, 0.9, Column::TimeMean) - 1.6e-4 * 2.0 * 10.0).abs() < 1e-8);
    }
}
