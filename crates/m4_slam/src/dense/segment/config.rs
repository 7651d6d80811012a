//! Settings of masks by a segmenter.

use crate::dense::DenseError;
use crate::dense::config::{need, shares, whole};
use serde::{Deserialize, Serialize};

/// What a segmenter is told of a part of the coarse mask, and when its answer is taken. Measured with MobileSAM: docs/geometry.md.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SegmentConfig {
    /// Parts of fewer pixels at the working size are left as they are.
    pub least_part_px: usize,
    /// Points on a part: the deepest, and others far from it and from each other.
    pub points: usize,
    /// How fast belief grows with the distance from the part's edge, logits a pixel at the working size.
    pub belief_per_px: f32,
    /// The firmest belief, logits: more holds the answer closer to the coarse mask.
    pub belief_limit: f32,
    /// Least quality that the segmenter expects of a mask that is taken (intersection over union).
    pub least_quality: f32,
    /// Least intersection over union with the part of a mask that is taken: what is far larger or smaller is another thing.
    pub least_overlap: f32,
}

impl Default for SegmentConfig {
    fn default() -> Self {
        Self {
            least_part_px: 60,
            points: 3,
            belief_per_px: 1.0,
            belief_limit: 4.0,
            least_quality: 0.7,
            least_overlap: 0.6,
        }
    }
}

impl SegmentConfig {
    /// Rejects settings that no prompt could use: [`DenseError::Setting`].
    pub(in crate::dense) fn check(&self) -> Result<(), DenseError> {
        whole(&[
            ("dense.segment.points", self.points, 1, 16),
            ("dense.segment.least_part_px", self.least_part_px, 1, 1_000_000),
        ])?;
        for (name, value) in [
            ("dense.segment.belief_per_px", self.belief_per_px),
            ("dense.segment.belief_limit", self.belief_limit),
        ] {
            need(
                value > 0.0 && value <= 100.0,
                name,
                value.into(),
                "above 0, at most 100",
            )?;
        }
        shares(&[
            ("dense.segment.least_quality", self.least_quality.into()),
            ("dense.segment.least_overlap", self.least_overlap.into()),
        ])
    }
}
