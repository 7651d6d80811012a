//! Rounds of density control on the device (Minute4D sec. 3.3): scores, the choice of splats, and
//! their new rows, of what [`crate::density::gpu`] computes.

use super::{GpuTrainer, move_phases, trainer::TRAINING};
use crate::density::gpu::{ImageGradients, Mask, Outcomes, Rank, Rows};
use crate::density::{DensityRound, DensityStats, ScoreSettings, Scores};
use cubecl::prelude::*;
use m4_kernels::launch;
use m4_kernels::{
    View,
    adam::FIXED,
    gpu::{
        Gpu, GpuError,
        buffer::{Buffer, cubes, units},
        tally::{LOSSES, Tally},
    },
    renderer::gpu::Size,
    score::gpu::{FrameScore, add},
    splats::{DeviceSplats, gathered},
};

impl GpuTrainer {
    /// Clones, splits and prunes splats by the rules of `round`. Survivors keep the optimiser's
    /// state, new splats start from nothing. Rows are in their old order, static before dynamic,
    /// the new ones after those that stay; halves lie 0.6 standard deviations to both sides along
    /// the longest axis, 0.8 as long there, or are drawn as on the CPU, to the last digits. Where
    /// nothing would be left, nothing changes. Fails with [`GpuError`] if there is no such frame,
    /// if there is no room, or if the device failed; the trainer is not to be used after that.
    pub fn densify(&mut self, round: &DensityRound<'_>) -> Result<DensityStats, GpuError> {
        let n = self.splats.n;
        let unchanged = DensityStats {
            n_static: self.splats.n_static,
            n_dynamic: n - self.splats.n_static,
            ..DensityStats::default()
        };
        if n == 0 {
            return Ok(unchanged);
        }
        let client = self.gpu.client.clone();
        let outcomes = self.outcomes(&client, round)?;
        let (grown, next, n_bound) = outcomes.read(&client, TRAINING)?;
        if grown.changes_nothing() || next == 0 {
            return Ok(unchanged);
        }
        let rows = Rows::new(&client, &outcomes, &self.splats, next);
        let shape = (next, grown.n_static);
        self.gather_adam(&rows.states, shape);
        let splats = gathered(&self.gpu, &self.splats, &rows.sources, shape);
        rows.shape(
            &client,
            &self.splats,
            &splats,
            grown.n_static + n_bound,
            round,
        );
        move_phases(&client, &self.splats, &splats, &rows.sources, round.period);
        let bound = self.splats.bound.as_ref();
        let n_static = unchanged.n_static;
        let bound = bound.map(|bound| {
            bound.gathered(
                &self.gpu,
                &rows.sources,
                n_static,
                (grown.n_static, n_bound),
            )
        });
        self.splats = DeviceSplats { bound, ..splats };
        self.gradients = self.splats.like(&self.gpu);
        self.make(Size {
            n: next,
            ..self.work.size
        })?;
        Ok(grown)
    }

    fn outcomes(
        &mut self,
        client: &Client,
        round: &DensityRound<'_>,
    ) -> Result<Outcomes, GpuError> {
        let (n, rules) = (self.splats.n, &round.rules);
        let (config, due) = (rules.config, rules.due);
        let scores = match &mut self.image_gradients {
            Some(sums) => sums.take(&self.gpu, n),
            None if due.densify || due.prune_by_score => self.scores(round.views, &round.scores)?,
            // of no consequence
            None => Buffer::empty(client, 2 * n),
        };
        let rank = Rank::new(client, n);
        let budget = if due.densify {
            due.budget(config, n)
        } else {
            0
        };
        let grows = rank.best(client, config.densify_threshold, budget, &scores);
        let range = match due.prune_by_score {
            true => rank.prune_range(client, config.prune_rule, &scores),
            // no range, no pruning by score
            false => Buffer::floats(client, &[0.0, 0.0]),
        };
        Ok(Outcomes::new(
            client,
            &self.splats,
            rules,
            &grows,
            &scores,
            &range,
        ))
    }
}

impl GpuTrainer {
    /// Renders each view of a frame, by its number, and adds up the errors on the footprints of the
    /// splats. Fails with [`GpuError`] if there is no such frame, if there is no room for the tile
    /// entries, or if the device failed.
    pub fn score(
        &mut self,
        views: &[(usize, View)],
        settings: &ScoreSettings,
    ) -> Result<Scores, GpuError> {
        let n = self.splats.n;
        let scores = self.scores(views, settings)?;
        read(&self.gpu, &scores, n)
    }

    /// [`score`](Self::score), left on the device: `[2][n]`.
    pub(crate) fn scores(
        &mut self,
        views: &[(usize, View)],
        settings: &ScoreSettings,
    ) -> Result<Buffer, GpuError> {
        let n = self.splats.n;
        let gpu = self.gpu.clone();
        let tally = Tally::new(&gpu, views.len());
        let scores = Buffer::zeros(&gpu.client, 2 * n);
        let mask = Mask::new(&gpu, self.work.size.pixels(), settings.range);
        let share = 1.0 / views.len().max(1) as f32;
        for (index, (frame, view)) in views.iter().enumerate() {
            self.draw(view)?;
            let target = self.frames.get(&gpu, *frame)?;
            let (shown, _) = self.corrected(*frame);
            self.loss
                .compare(&gpu, &shown, &target, index, settings.lambda_ssim, &tally);
            mask.find(&gpu, &shown, &target, settings.threshold);
            let frame = FrameScore {
                errors: &mask.errors,
                cut: &mask.cut,
                tally: &tally.buffer,
                loss: LOSSES + index,
                share,
            };
            add(&gpu, &self.work, &self.splats, &frame, &scores);
        }
        launch!(
            &gpu.client,
            forget_fixed::launch,
            (cubes(n, 256), units()),
            [self.adam.steps, scores],
            [n as u32]
        );
        Ok(scores)
    }
}

impl GpuTrainer {
    /// Collects the gradients with respect to the centres of splats in the image from here on; they
    /// take the place of the scores of density control.
    pub fn collect_image_gradients(&mut self) {
        self.image_gradients
            .get_or_insert_with(|| ImageGradients::new(&self.gpu, self.splats.n));
    }

    /// Waits, and says what a round of density control would go by now: the mean lengths of the
    /// gradients in the image in place of the scores, 0 where none are collected. Fails with
    /// [`GpuError`] if the device failed since.
    pub fn image_gradients(&mut self) -> Result<Scores, GpuError> {
        let n = self.splats.n;
        match &mut self.image_gradients {
            Some(sums) => read(&self.gpu, &sums.means(&self.gpu, n), n),
            None => Ok(Scores {
                densify: vec![0.0; n],
                prune: vec![0.0; n],
            }),
        }
    }
}

/// Waits, and copies the scores of `n` splats back. Fails with [`GpuError`] if the device failed.
fn read(gpu: &Gpu, scores: &Buffer, n: usize) -> Result<Scores, GpuError> {
    let mut both = scores.read_floats(&gpu.client, TRAINING)?;
    both.truncate(2 * n);
    let prune = both.split_off(n);
    Ok(Scores {
        densify: both,
        prune,
    })
}

/// Sets both scores of fixed splats to 0.
#[cube(launch)]
fn forget_fixed(steps: &[u32], scores: &mut [f32], n: u32) {
    let i = ABSOLUTE_POS as u32;
    if i < n {
        let step = steps[i as usize];
        if step == FIXED {
            scores[i as usize] = 0.0f32;
            scores[(n + i) as usize] = 0.0f32;
        }
    }
}
