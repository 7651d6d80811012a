//! Density control with a device: decided by the device, or scored there and decided on the host.

use crate::{
    TrainError,
    config::SplitPlacement,
    density::{Origin, Plan, Rules, Scores, apply_to_splats},
    device::{DensifyPlan, DeviceRound, ScoreSettings},
    trainer::Trainer,
};
use m4_kernels::View;

impl Trainer<'_> {
    /// Scores of all splats on some frames.
    pub(in crate::trainer) fn score_on_gpu(&mut self, looks: &[(usize, View)]) -> Result<Scores, TrainError> {
        self.prepare_remote()?;
        let settings = self.score_settings();
        self.on_gpu(|device| device.score(looks, &settings))
    }

    fn score_settings(&self) -> ScoreSettings {
        ScoreSettings {
            lambda_ssim: self.config.lambda_ssim,
            threshold: self.config.density.error_threshold,
            range: self.config.density.error_range,
        }
    }

    /// A round of density control on the device; false where that is left to the processor.
    pub(in crate::trainer) fn densify_on_gpu(&mut self, rules: &Rules<'_>) -> Result<bool, TrainError> {
        let (config, due) = (rules.config, rules.due);
        if due.densify && config.split_placement == SplitPlacement::Sample {
            // random numbers are drawn here
            return Ok(false);
        }
        let mut looks = Vec::new();
        if due.densify || due.prune_by_score {
            self.prepare_remote()?;
            looks = self.frames_to_score();
        }
        let round = DeviceRound {
            looks: &looks,
            scores: self.score_settings(),
            rules: *rules,
        };
        let Some(grown) = self.on_gpu(|device| device.densify(&round))? else {
            return Ok(false);
        };
        if !grown.changes_nothing() {
            if let Some(gpu) = &mut self.gpu {
                gpu.counts = Some((grown.n_static, grown.n_dynamic));
            }
            self.reorder_on_gpu()?;
        }
        Ok(true)
    }

    /// Carries a plan out here for the splats, there for the optimiser's state.
    pub(in crate::trainer) fn carry_out_on_gpu(&mut self, plan: &Plan) -> Result<(), TrainError> {
        apply_to_splats(
            &self.config.density,
            plan,
            &mut self.splats,
            self.config.seed,
            self.iteration,
        )?;
        let rows = plan.origins.iter().enumerate();
        let changed: Vec<u32> = rows
            .filter(|(_, origin)| **origin != Origin::Kept)
            .map(|(row, _)| row as u32)
            .collect();
        let (n_static, is_new, values) = (self.splats.n_static(), plan.is_new(), self.splats.gather(&changed)?);
        self.on_gpu(|device| {
            device.regrow(&DensifyPlan {
                rows: &plan.rows,
                n_static,
                is_new: &is_new,
                changed: &changed,
                values: &values,
            })
        })?;
        self.reorder_on_gpu()
    }
}
