//! Settings, with their sources, and what can go wrong.

use super::PairFlowError;
use super::cvd::{CVD_STEPS, CvdError, PairError};
use super::tracker::mono::MonoError;
use super::tracker::{TrackerError, TrackerSettings};
use serde::{Deserialize, Serialize};

/// Share of motion (1 - static confidence) above which a pixel counts as dynamic. 0.7: the paper's tau.
pub const TAU_MOTION: f64 = 0.7;

/// Settings of [`super::reconstruct()`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MegasamSettings {
    /// Pixels of the images that are tracked. `384 * 512`: MegaSaM (docs/spec/front-end.md 1.1). The cost is proportional. For callers in Rust.
    #[serde(skip)]
    pub tracking_pixels: f64,
    /// Of the tracker. docs/spec/front-end.md 1.5. For callers in Rust.
    #[serde(skip)]
    pub tracker: TrackerSettings,
    /// Adam steps of both stages of consistent video depth. docs/spec/front-end.md 1.7. For callers in Rust.
    #[serde(skip)]
    pub cvd_steps: [usize; 2],
    /// Iterations of a recurrent network of flow. 22: MegaSaM.
    pub flow_iterations: usize,
    /// Megabytes of flow that stay in memory; the rest is on disk. 1,000: ours.
    pub flow_budget_mb: usize,
    /// Megabytes of the tracking network's features and states that stay in memory; the rest is on disk. 2,000: ours; a clip of
    /// 100 frames of 854 x 480 pixels has 1,500.
    pub memory_budget_mb: usize,
    /// Field of view where neither the user nor the depth knows one, degrees across. 60: ours, the main camera of common
    /// phones.
    pub default_fov_deg: f64,
}

impl Default for MegasamSettings {
    fn default() -> Self {
        Self {
            tracking_pixels: 384.0 * 512.0,
            tracker: TrackerSettings::default(),
            cvd_steps: CVD_STEPS,
            flow_iterations: 22,
            flow_budget_mb: 1000,
            memory_budget_mb: 2000,
            default_fov_deg: 60.0,
        }
    }
}

/// Why there is no geometry.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MegasamError {
    /// Images, instants or depth that do not fit together or are too small; the text says which.
    #[error("{0}")]
    Input(String),
    /// Depth without scale.
    #[error(transparent)]
    Mono(#[from] MonoError),
    /// Cameras could not be found.
    #[error(transparent)]
    Tracker(#[from] TrackerError),
    /// Flow could not be had.
    #[error(transparent)]
    Flow(#[from] PairFlowError),
    /// Flow could not be kept.
    #[error(transparent)]
    Pairs(#[from] PairError),
    /// Depth could not be made consistent.
    #[error(transparent)]
    Depth(#[from] CvdError),
    /// The user stopped.
    #[error("stopped by the user")]
    Cancelled,
}

impl MegasamError {
    /// True where the user stopped.
    #[must_use]
    pub fn is_stop(&self) -> bool {
        matches!(
            self,
            Self::Cancelled | Self::Tracker(TrackerError::Cancelled) | Self::Depth(CvdError::Cancelled { .. })
        )
    }
}
