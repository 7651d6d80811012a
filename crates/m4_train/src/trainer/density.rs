//! The schedule of density control and its inputs.

use super::Trainer;
use crate::{
    TrainError,
    density::{Decision, Plan, Rules, ScoreInput, Scores, apply, score},
    pick::purpose,
};
use m4_core::CounterRng;
use m4_kernels::View;

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
        let (min_opacity, final_opacity) = (c.min_opacity, c.final_opacity);
        if due.densify || due.prune_by_score {
            self.round(due, min_opacity)?;
        }
        if last {
            let nothing = Decision {
                densify: false,
                prune_by_score: false,
                max_splats: 0,
            };
            self.round(nothing, final_opacity)?;
        }
        Ok(())
    }

    fn round(&mut self, due: Decision, min_opacity: f32) -> Result<(), TrainError> {
        let (config, scale) = (self.config.density.clone(), self.scale.clone());
        let rules = Rules {
            config: &config,
            due,
            min_opacity,
            scale: &scale,
        };
        if self.gpu.is_some() && self.densify_on_gpu(&rules)? {
            return Ok(());
        }
        self.download_splats()?;
        let scores = if due.densify || due.prune_by_score {
            self.scores()?
        } else {
            let none = vec![0.0; self.splats.n()];
            Scores {
                densify: none.clone(),
                prune: none,
            }
        };
        let plan = rules.plan(&self.splats, &scores);
        self.carry_out(&plan)
    }

    fn carry_out(&mut self, plan: &Plan) -> Result<(), TrainError> {
        // A set of splats is never emptied: whatever the rules say, there must be something to train.
        if plan.changes_nothing() || plan.rows.is_empty() {
            return Ok(());
        }
        if self.gpu.is_some() {
            return self.carry_out_on_gpu(plan);
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

    /// Both scores, over one draw of frames.
    fn scores(&mut self) -> Result<Scores, TrainError> {
        let frames = self.frames_to_score();
        if self.gpu.is_some() {
            return self.score_on_gpu(&frames);
        }
        let mut input = ScoreInput {
            level: self.level,
            config: &self.config.density,
            lambda_ssim: self.config.lambda_ssim,
            store: &mut self.store,
            fit: self.config.refine.exposure.then_some(&self.fit),
            renderer: &mut self.renderer,
            scratch: &mut self.photo,
        };
        Ok(score(&mut input, &self.splats, &frames))
    }

    /// Frames drawn for the scores, and how they are seen.
    pub(super) fn frames_to_score(&self) -> Vec<(usize, View)> {
        let mut rng = CounterRng::new(self.config.seed, purpose::DENSIFY_FRAMES, self.iteration as u64);
        let picked = rng.sample(self.times.len(), self.config.density.frames);
        picked.into_iter().map(|f| (f, self.view(f))).collect()
    }
}
