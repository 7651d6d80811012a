//! The rules of one round, and the plan that follows from them.

use super::{Decision, Plan, Scores, SplatView, decide};
use crate::{
    SceneScale,
    config::{DensityConfig, SplitSize},
};
use m4_core::{Column, Splats};

/// What a round goes by.
#[derive(Debug, Clone, Copy)]
pub struct Rules<'a> {
    /// Thresholds and budgets.
    pub config: &'a DensityConfig,
    /// What is due.
    pub due: Decision,
    /// Splats of a lower opacity go; instead of that of [`config`](Self::config).
    pub min_opacity: f32,
    /// The lengths that sizes are measured in.
    pub scale: &'a SceneScale,
}

impl Rules<'_> {
    /// What becomes of `splats` with these scores, `[n]` each.
    #[must_use]
    pub fn plan(&self, splats: &Splats, scores: &Scores) -> Plan {
        let mut config = self.config.clone();
        config.min_opacity = self.min_opacity;
        let n = splats.n();
        let scales = splats.layout().range(Column::LogScale).len();
        let largest: Vec<f32> = (0..n)
            .map(|i| (0..scales).map(|k| splats.column(Column::LogScale, k)[i]).fold(f32::NEG_INFINITY, f32::max).exp())
            .collect();
        let mean = |i: usize| [0, 1, 2].map(|k| splats.column(Column::Mean, k)[i]);
        let limit = |i: usize| match config.split_size {
            SplitSize::Extent { share } => share * self.scale.extent,
            SplitSize::Pixels { pixels } => pixels * self.scale.nearest_camera(mean(i)) / self.scale.focal_px,
        };
        let large: Vec<bool> = (0..n).map(|i| largest[i] > limit(i)).collect();
        let opacity: Vec<f32> = splats.column(Column::Opacity, 0).iter().map(|&l| 1.0 / (1.0 + (-l).exp())).collect();
        let view = SplatView { n_static: splats.n_static(), opacity: &opacity, large: &large };
        decide(&config, self.due, view, scores)
    }
}
