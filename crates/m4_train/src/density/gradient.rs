//! Densification by gradients, as in 3DGS (Kerbl et al. 2023, section 5.2): the rule that
//! loss-guided density control replaces.
//!
//! The statistic of a splat is the length of the gradient with respect to its centre in the image,
//! in units of half the image, mean over the frames that saw it since the last round
//! (docs/spec/optimiser.md 1.7). Constants: [`crate::DensityConfig::by_gradient`]. As in Instant4D,
//! opacities are not reset, and splats that are too large are not pruned. A run that is resumed
//! starts the mean anew.

use crate::density::Scores;

/// Sums of the lengths over frames.
#[derive(Debug, Clone, Default)]
pub(crate) struct GradientSums {
    sums: Vec<f32>,
    frames: Vec<u32>,
}

impl GradientSums {
    /// Adds a frame: `lengths[i]` where `touched[i]` is not 0.
    pub(crate) fn add(&mut self, lengths: &[f32], touched: &[u8]) {
        self.fit(lengths.len());
        for (i, &length) in lengths.iter().enumerate().filter(|&(i, _)| touched[i] != 0) {
            self.sums[i] += length;
            self.frames[i] += 1;
        }
    }

    /// The means as the scores of `n` splats, none of which is pruned by score; the sums start
    /// anew.
    pub(crate) fn take(&mut self, n: usize) -> Scores {
        self.fit(n);
        let sums = std::mem::take(self);
        let mean = |(sum, frames): (&f32, &u32)| sum / (*frames).max(1) as f32;
        Scores {
            densify: sums.sums.iter().zip(&sums.frames).map(mean).collect(),
            prune: vec![0.0; n],
        }
    }

    /// Follows splats that were [rearranged](m4_core::Splats::rearrange).
    pub(crate) fn rearrange(&mut self, rows: &[u32]) {
        self.fit(rows.len());
        self.sums = rows.iter().map(|&row| self.sums[row as usize]).collect();
        self.frames = rows.iter().map(|&row| self.frames[row as usize]).collect();
    }

    /// Starts anew where there are other splats than before.
    fn fit(&mut self, n: usize) {
        if self.sums.len() != n {
            (self.sums, self.frames) = (vec![0.0; n], vec![0; n]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::GradientSums;
    use crate::config::DensityConfig;
    use crate::density::{Decision, Origin, SplatView, decide};

    #[test]
    fn means_are_over_the_frames_that_saw_a_splat() {
        let mut sums = GradientSums::default();
        sums.add(&[4.0, 9.0, f32::NAN], &[1, 0, 0]);
        sums.add(&[2.0, 1.0, f32::NAN], &[1, 1, 0]);
        sums.rearrange(&[2, 0, 1]);
        assert_eq!(sums.take(3).densify, [0.0, 3.0, 1.0]);
        assert_eq!(
            sums.take(3).densify,
            [0.0; 3],
            "a round starts the sums anew"
        );
        sums.add(&[1.0], &[1]);
        assert_eq!(sums.take(2).densify, [0.0; 2], "other splats");
    }

    #[test]
    fn splats_above_the_threshold_of_3dgs_are_cloned_or_split_and_transparent_ones_pruned() {
        let mut sums = GradientSums::default();
        sums.add(&[3e-4, 1e-4, 3e-4, 1e-4], &[1; 4]);
        let view = SplatView {
            n_static: 4,
            n_bound: 0,
            opacity: &[0.5, 0.5, 0.5, 0.004],
            large: &[false, true, true, false],
            oversized: &[false; 4],
        };
        let due = Decision {
            densify: true,
            prune_by_score: false,
            prune_large: false,
            max_splats: 100,
        };
        let plan = decide(&DensityConfig::by_gradient(), due, view, &sums.take(4));
        assert_eq!(plan.rows, [0, 1, 0, 2, 2]);
        use Origin::{Child, Clone, Cloned, Kept};
        assert_eq!(plan.origins, [Cloned, Kept, Clone, Child(0), Child(1)]);
        assert_eq!(plan.pruned, 1);
    }
}
