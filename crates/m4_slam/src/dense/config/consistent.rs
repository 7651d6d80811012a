//! Settings of depth that agrees over time.

use super::check::{above_zero, need};
use crate::cvd::CvdSettings;
use crate::dense::DenseError;
use serde::{Deserialize, Serialize};

/// Consistent video depth of what stands still.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ConsistentConfig {
    /// Whether it is done at all.
    pub enabled: bool,
    /// How firmly pixels on which all partners agree stay where they are.
    pub prior: f32,
    /// Flow of a pair counts if it misses where measured depth leads by at most this share of the parallax, medians over what
    /// was measured.
    pub flow_miss: f32,
    /// Memory for flow; more goes to a temporary file, bytes.
    pub flow_bytes: usize,
    /// The optimisation.
    pub optimiser: CvdSettings,
}

impl Default for ConsistentConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            prior: 1.0,
            flow_miss: 0.06,
            flow_bytes: 512 << 20,
            optimiser: CvdSettings::default(),
        }
    }
}

impl ConsistentConfig {
    /// Rejects settings that no computation could use: [`DenseError::Setting`].
    pub(super) fn check(&self) -> Result<(), DenseError> {
        above_zero(&[("dense.consistent.flow_miss", self.flow_miss.into())])?;
        let good = self.prior >= 0.0 && self.prior.is_finite();
        need(good, "dense.consistent.prior", self.prior.into(), "0 or more")
    }
}
