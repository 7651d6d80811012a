//! What is due before or after some steps: degrees of colours, density control, the fit of colours.

use crate::{
    TrainError,
    colour_degree::add_coefficients,
    colour_fit::correct,
    config::LARGE_FROM,
    density::{Decision, DensityRound, Rules, ScoreSettings},
    schedule::{period, progress, purpose},
    trainer::Trainer,
};
use m4_core::{CounterRng, Progress};
use m4_kernels::View;
use std::cell::Cell;

impl Trainer<'_> {
    /// Adds and removes splats if this iteration is due.
    pub(super) fn density_round(&mut self) -> Result<(), TrainError> {
        let c = &self.config.density;
        let (i, n) = (self.iteration, self.config.iterations);
        let due = Decision {
            densify: c.is_due(c.every, i, n),
            prune_by_score: c.loss_guided && c.is_due(c.prune_every, i, n),
            prune_large: c.prune_large
                && i as f64 > f64::from(LARGE_FROM) * n as f64
                && c.is_due(c.every, i, n),
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
                prune_large: false,
                max_splats: 0,
            };
            self.round(nothing, final_opacity)?;
        }
        Ok(())
    }

    fn round(&mut self, due: Decision, min_opacity: f32) -> Result<(), TrainError> {
        let (config, scale) = (self.config.density.clone(), self.scale.clone());
        let mut views = Vec::new();
        if due.densify || due.prune_by_score {
            self.settle()?;
            self.prepare()?;
            if config.loss_guided {
                views = self.frames_to_score();
            }
        }
        let round = DensityRound {
            views: &views,
            scores: ScoreSettings {
                lambda_ssim: self.config.lambda_ssim,
                threshold: config.error_threshold,
                range: config.error_range,
            },
            rules: Rules {
                config: &config,
                due,
                min_opacity,
                scale: &scale,
            },
            period: period(self.time_frames),
            seed: self.config.seed,
            iteration: self.iteration,
        };
        let stats = self.ask(|backend| backend.densify(&round))?;
        if !stats.changes_nothing() {
            self.counts = (stats.n_static, stats.n_dynamic);
            self.reorder()?;
        }
        Ok(())
    }

    /// Frames drawn for the scores, and how they are seen.
    fn frames_to_score(&self) -> Vec<(usize, View)> {
        let mut rng = CounterRng::new(
            self.config.seed,
            purpose::DENSIFY_FRAMES,
            self.iteration as u64,
        );
        let picked = rng.sample(self.times.len(), self.config.density.frames);
        picked.into_iter().map(|f| (f, self.view(f))).collect()
    }
}

impl Trainer<'_> {
    /// Solves for the colours after the last step; weights are measured once. False where the
    /// caller asked to stop: nothing is changed then.
    pub(super) fn fit_colours(&mut self, progress: &dyn Progress) -> Result<bool, TrainError> {
        self.settle()?;
        let views: Vec<(usize, View)> = (0..self.times.len())
            .map(|frame| (frame, self.view(frame)))
            .collect();
        self.prepare()?;
        self.download()?;
        let (mut weight, first) = (Default::default(), self.splats.clone());
        for round in 0..self.config.colour_fit_rounds {
            let stopped = Cell::new(false);
            let stop = || {
                stopped.set(stopped.get() || progress.cancelled());
                stopped.get()
            };
            let sums = self.ask(|backend| backend.colour_sums(&views, round == 0, &stop))?;
            if stopped.get() {
                self.ask(|backend| backend.set_splats(&first))?;
                self.splats = first;
                return Ok(false);
            }
            if round == 0 {
                weight = sums.weight;
            }
            let mut splats = self.splats.clone();
            correct(&mut splats, &sums.residual, &weight);
            self.ask(|backend| backend.set_splats(&splats))?;
            // as they are there; not yet checked, as `download` does
            self.splats = splats;
        }
        self.is_current = false;
        self.is_fitted = true;
        self.download()?;
        Ok(true)
    }
}

impl Trainer<'_> {
    /// Adds the colour coefficients that are due before this step, if any are. What is due follows
    /// from the step and the splats alone, so that a run that is resumed here adds them as well.
    pub(super) fn degree_round(&mut self) -> Result<(), TrainError> {
        let degree = self
            .config
            .colour_degree
            .at(progress(self.iteration, self.config.iterations));
        let layout = degree.raise(self.splats.layout());
        if layout != self.splats.layout() {
            self.synchronize()?;
            add_coefficients(&mut self.splats, &mut self.adam, layout);
        }
        Ok(())
    }
}
