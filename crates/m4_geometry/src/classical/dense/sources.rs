//! The methods and settings of the dense half. All other values are constants of the files that use them.

use super::DenseError;
use super::flow::FlowSource;
use super::mono::{MonoDepth, NoDepth};
use super::segment::Segmenter;
use serde::{Deserialize, Serialize};

/// The methods for flow, segmentation and monocular depth.
#[derive(Clone, Copy)]
pub struct Sources<'a> {
    /// Measures flow between neighbouring frames.
    pub flow: &'a dyn FlowSource,
    /// Segments dynamic regions, if present; masks of the user stay as they are.
    pub segmenter: Option<&'a dyn Segmenter>,
    /// Depth from one image: [`NoDepth`] if there is none.
    pub mono: &'a dyn MonoDepth,
}

impl<'a> Sources<'a> {
    /// Flow alone.
    #[must_use]
    pub fn flow(flow: &'a dyn FlowSource) -> Self {
        Self { flow, segmenter: None, mono: &NoDepth }
    }
}

/// Settings of [`super::estimate()`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DenseConfig {
    /// Longest side of the images that flow, depth and masks are computed on, pixels; frames that are smaller are used as they are.
    /// The specification has "320-384"; 480 finds masks and thin parts that 320 misses and keeps 96 frames under a minute and a half
    /// on two cores.
    pub working_side_px: usize,
    /// Memory for the planes of all frames together, megabytes: long clips are processed at a smaller size. 4096: 270 frames at 480x360.
    pub memory_mb: usize,
    /// Whether points of the dynamic region are tracked through the clip.
    pub tracks: bool,
}

impl Default for DenseConfig {
    fn default() -> Self {
        Self { working_side_px: 480, memory_mb: 4096, tracks: true }
    }
}

impl DenseConfig {
    /// Rejects a working size that no computation could use: [`DenseError::Setting`].
    pub(super) fn check(&self) -> Result<(), DenseError> {
        if (64..=2048).contains(&self.working_side_px) {
            return Ok(());
        }
        Err(DenseError::Setting {
            name: "dense.working_side_px",
            value: self.working_side_px as f64,
            range: "64 to 2048",
        })
    }
}
