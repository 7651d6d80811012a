//! When density control is due, and what it is given.

use super::Trainer;
use crate::TrainError;
use crate::config::SplitSize;
use crate::density::{Decision, Plan, ScoreInput, Scores, SplatView, apply, decide, score};
use crate::pick::purpose;
use m4_math::CounterRng;
use m4_scene::Column;

impl Trainer<'_> {
    /// Adds and removes splats if this iteration is due.
    pub(super) fn density_round(&mut self) -> Result<(), TrainError> {
        let c = &self.config.density;
        let (i, n) = (self.iteration, self.config.iterations);
        let within = c.enabled && i >= c.from && i as f64 <= f64::from(c.until) * n as f64;
        let due = Decision {
            densify: within && i.is_multiple_of(c.every),
            prune_by_score: within && i.is_multiple_of(c.prune_every),
            max_splats: (f64::from(c.max_growth) * self.first_splats as f64) as usize,
        };
        let last = c.enabled && i == n && c.final_opacity > 0.0;
        if due.densify || due.prune_by_score {
            let scores = self.scores(due.prune_by_score)?;
            self.bring_splats()?;
            let plan = self.plan(due, self.config.density.min_opacity, &scores);
            self.carry_out(&plan)?;
        }
        if last {
            self.bring_splats()?;
            let nothing = Decision {
                densify: false,
                prune_by_score: false,
                max_splats: 0,
            };
            let none = Scores {
                densify: vec![0.0; self.splats.n()],
                prune: vec![0.0; self.splats.n()],
            };
            let plan = self.plan(nothing, self.config.density.final_opacity, &none);
            self.carry_out(&plan)?;
        }
        Ok(())
    }

    fn carry_out(&mut self, plan: &Plan) -> Result<(), TrainError> {
        // A set of splats is never emptied: whatever the rules say, there must be something to train.
        if plan.changes_nothing() || plan.rows.is_empty() {
            return Ok(());
        }
        if self.remote.is_some() {
            return self.carry_out_remotely(plan);
        }
        apply(
            &self.config.density,
            plan,
            &mut self.splats,
            &mut self.adam,
            self.config.seed,
            self.iteration,
        )?;
        self.reorder()
    }

    /// Both scores, over one or two draws of frames.
    fn scores(&mut self, prune: bool) -> Result<Scores, TrainError> {
        let mut scores = self.scores_of(purpose::DENSIFY_FRAMES)?;
        if prune && self.config.density.prune_own_frames {
            scores.prune = self.scores_of(purpose::PRUNE_FRAMES)?.prune;
        }
        Ok(scores)
    }

    fn scores_of(&mut self, purpose: u64) -> Result<Scores, TrainError> {
        let mut rng = CounterRng::new(self.config.seed, purpose, self.iteration as u64);
        let picked = rng.sample(self.times.len(), self.config.density.frames);
        let factor = self.factor();
        let frames: Vec<_> = picked.into_iter().map(|f| (f, self.view(f, factor, false))).collect();
        if self.remote.is_some() {
            return self.score_remotely(&frames);
        }
        let mut input = ScoreInput {
            level: self.level,
            config: &self.config.density,
            lambda_ssim: self.config.loss.lambda_ssim,
            factor,
            store: &mut self.store,
            fit: self.config.refine.exposure.then_some(&self.fit),
            renderer: &mut self.renderer,
            scratch: &mut self.photo,
        };
        Ok(score(&mut input, &self.splats, &frames))
    }

    fn plan(&self, due: Decision, min_opacity: f32, scores: &Scores) -> Plan {
        let mut config = self.config.density.clone();
        config.min_opacity = min_opacity;
        let n = self.splats.n();
        let scales = self.splats.layout().range(Column::LogScale).len();
        let largest: Vec<f32> = (0..n)
            .map(|i| {
                (0..scales)
                    .map(|k| self.splats.column(Column::LogScale, k)[i])
                    .fold(f32::NEG_INFINITY, f32::max)
                    .exp()
            })
            .collect();
        let mean = |i: usize| [0, 1, 2].map(|k| self.splats.column(Column::Mean, k)[i]);
        let limit = |i: usize| match config.split_size {
            SplitSize::Extent { share } => share * self.scale.extent,
            SplitSize::Pixels { pixels } => pixels * self.scale.nearest_camera(mean(i)) / self.scale.focal_px,
        };
        let large: Vec<bool> = (0..n).map(|i| largest[i] > limit(i)).collect();
        let sized = config.max_size > 0.0 && self.iteration >= config.size_from;
        let too_large = config.max_size * self.scale.extent;
        let oversized: Vec<bool> = largest.iter().map(|&s| sized && s > too_large).collect();
        let opacity: Vec<f32> = self
            .splats
            .column(Column::Opacity, 0)
            .iter()
            .map(|&l| 1.0 / (1.0 + (-l).exp()))
            .collect();
        let view = SplatView {
            n_static: self.splats.n_static(),
            opacity: &opacity,
            large: &large,
            oversized: &oversized,
        };
        decide(&config, due, view, scores)
    }
}
