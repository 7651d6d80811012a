//! Settings of masks by a segmenter.

use super::super::DenseError;
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
    /// Rejects settings that no prompt could use.
    ///
    /// # Errors
    ///
    /// [`DenseError::Setting`], what `need` makes of it.
    pub(in super::super) fn check(
        &self,
        need: &impl Fn(bool, &'static str, f64, &'static str) -> Result<(), DenseError>,
    ) -> Result<(), DenseError> {
        let n = self.points;
        need((1..=16).contains(&n), "dense.segment.points", n as f64, "1 to 16")?;
        let least = self.least_part_px;
        need(
            (1..=1_000_000).contains(&least),
            "dense.segment.least_part_px",
            least as f64,
            "1 to 1000000",
        )?;
        let beliefs = [
            ("dense.segment.belief_per_px", self.belief_per_px),
            ("dense.segment.belief_limit", self.belief_limit),
        ];
        for (name, value) in beliefs {
            let good = value > 0.0 && value <= 100.0;
            need(good, name, f64::from(value), "above 0, at most 100")?;
        }
        let shares = [
            ("dense.segment.least_quality", self.least_quality),
            ("dense.segment.least_overlap", self.least_overlap),
        ];
        for (name, value) in shares {
            need((0.0..=1.0).contains(&value), name, f64::from(value), "0 to 1")?;
        }
        Ok(())
    }
}
