//! Settings of the search for flow.

use super::check::{above_zero, need};
use crate::dense::DenseError;
use serde::{Deserialize, Serialize};

/// Inverse-search flow with variational refinement (Kroeger et al. 2016).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlowConfig {
    /// Side of a patch, pixels. Kroeger et al. and the specification: 8.
    pub patch_px: usize,
    /// Distance of patches, pixels. Specification: 4.
    pub stride_px: usize,
    /// Gauss-Newton steps a patch and level. Kroeger et al.: 12.
    pub iterations: usize,
    /// Linearisations of the variational energy a level. Kroeger et al.: level + 1; 3 measured as good.
    pub refinements: usize,
    /// Relaxation sweeps a linearisation. Kroeger et al.: 3 to 5.
    pub relaxations: usize,
    /// Weight of smoothness. As in OpenCV's implementation of the paper: 20.
    pub smoothness: f32,
    /// Weight of equal brightness. Kroeger et al.: 5.
    pub brightness: f32,
    /// Weight of equal gradients. Kroeger et al.: 10.
    pub gradient: f32,
}

impl Default for FlowConfig {
    fn default() -> Self {
        Self {
            patch_px: 8,
            stride_px: 4,
            iterations: 12,
            refinements: 3,
            relaxations: 5,
            smoothness: 20.0,
            brightness: 5.0,
            gradient: 10.0,
        }
    }
}

impl FlowConfig {
    /// Rejects settings that no computation could use: [`DenseError::Setting`].
    pub(super) fn check(&self) -> Result<(), DenseError> {
        let patch = self.patch_px;
        need(
            (4..=16).contains(&patch),
            "dense.flow.patch_px",
            patch as f64,
            "4 to 16",
        )?;
        let stride = self.stride_px;
        need(
            (1..=patch).contains(&stride),
            "dense.flow.stride_px",
            stride as f64,
            "1 to patch_px",
        )?;
        above_zero(&[("dense.flow.smoothness", self.smoothness.into())])
    }
}
