//! Training steps on a GPU, behind the trainer's interface.

use m4_core::{Exposure, SplatLayout, Splats};
use m4_kernels::View;
use m4_kernels::adam::cpu::AdamState;
use m4_kernels::gpu::{DensityRound, Gpu, GpuError, GrowRule, Look, Plan, ScoreRange, StepSettings, Trainer};
use m4_kernels::loss::cpu::Target;
use m4_train::config::{CloneOpacity, ErrorRange, PruneRule, SplitSize};
use m4_train::density::{Rules, Scores};
use m4_train::device::{
    ColourGradient, DensifyPlan, DensifyStats, DeviceFound, DeviceLook, DeviceRound, DeviceStep, ScoreSettings,
};
use m4_train::{Device, DeviceError};

/// A GPU that trains.
#[derive(Debug)]
pub(super) struct GpuTraining {
    gpu: Gpu,
    /// Most memory that it may take; all that there is for `None`.
    limit_bytes: Option<u64>,
    /// Steps look at several frames.
    batches: bool,
    /// Frames that wait for the first splats.
    waiting: Vec<Target>,
    trainer: Option<Trainer>,
    /// Of the splats that it has.
    shape: Option<Shape>,
}

/// What memory depends on.
#[derive(Debug, Clone, Copy)]
struct Shape {
    n_static: usize,
    n_dynamic: usize,
    layout: SplatLayout,
}

impl Shape {
    fn of(splats: &Splats) -> Self {
        Self {
            n_static: splats.n_static(),
            n_dynamic: splats.n_dynamic(),
            layout: splats.layout(),
        }
    }
}

impl GpuTraining {
    pub fn new(gpu: Gpu, max_vram_mb: Option<usize>, batch: usize) -> Self {
        Self {
            gpu,
            limit_bytes: max_vram_mb.map(|mb| mb as u64 * 1_000_000),
            batches: batch > 1,
            waiting: Vec::new(),
            trainer: None,
            shape: None,
        }
    }

    fn trainer(&mut self) -> Result<&mut Trainer, DeviceError> {
        self.trainer
            .as_mut()
            .ok_or_else(|| DeviceError("the GPU was asked to work before it had splats".to_owned()))
    }

    /// Bytes for frames on the device, those that fit beside everything else. The others are sent when they are used.
    fn budget(&self, shape: Shape, frames: &[Target]) -> Result<usize, GpuError> {
        let size = frames.first().map_or((0, 0), |f| (f.width(), f.height()));
        let plan = |frames, entries| {
            let Shape {
                n_static,
                n_dynamic,
                layout,
            } = shape;
            let plan = Plan::training(n_static, n_dynamic, layout, size, frames, entries);
            if self.batches { plan.with_batches() } else { plan }
        };
        let entries = Plan::first_entries(shape.n_static + shape.n_dynamic);
        let least = plan(1, entries);
        least.check_buffers(&self.gpu)?;
        let Some(limit) = self.limit_bytes else {
            return Ok(usize::MAX);
        };
        least.check(limit)?;
        // frames leave room for as many entries as images usually have
        let all = plan(frames.len(), entries + ENTRIES * shape.n_static);
        Ok(usize::try_from(all.frames_budget(limit)).unwrap_or(usize::MAX))
    }
}

/// Entries of tiles that a static splat usually has.
const ENTRIES: usize = 4;

fn score_settings(settings: &ScoreSettings) -> m4_kernels::gpu::ScoreSettings {
    m4_kernels::gpu::ScoreSettings {
        lambda_ssim: settings.lambda_ssim,
        threshold: settings.threshold,
        range: match settings.range {
            ErrorRange::MinMax => ScoreRange::MinMax,
            ErrorRange::Quantile { high } => ScoreRange::Quantile { high },
        },
    }
}

fn failed(error: GpuError) -> DeviceError {
    DeviceError(error.to_string())
}

impl Device for GpuTraining {
    fn name(&self) -> String {
        self.gpu.adapter().name.clone()
    }

    fn set_frames(&mut self, frames: Vec<Target>) -> Result<(), DeviceError> {
        self.waiting = frames;
        Ok(())
    }

    fn set_exposures(&mut self, exposures: &[Exposure]) -> Result<(), DeviceError> {
        self.trainer()?.set_exposures(exposures);
        Ok(())
    }

    fn upload(&mut self, splats: &Splats, adam: &AdamState) -> Result<(), DeviceError> {
        let shape = Shape::of(splats);
        self.shape = Some(shape);
        if let Some(trainer) = &mut self.trainer {
            return trainer.replace(splats, adam).map_err(failed);
        }
        let frames = std::mem::take(&mut self.waiting);
        let budget = self.budget(shape, &frames).map_err(failed)?;
        let mut trainer = Trainer::new(self.gpu.clone(), splats, adam, &frames, budget).map_err(failed)?;
        trainer.set_limit(self.limit_bytes);
        self.trainer = Some(trainer);
        Ok(())
    }

    fn regrow(&mut self, next: &DensifyPlan<'_>) -> Result<(), DeviceError> {
        if let Some(shape) = &mut self.shape {
            shape.n_static = next.n_static;
            shape.n_dynamic = next.rows.len() - next.n_static;
        }
        let next = m4_kernels::gpu::DensifyPlan {
            rows: next.rows,
            n_static: next.n_static,
            is_new: next.is_new,
            changed: next.changed,
            values: next.values,
        };
        self.trainer()?.regrow(&next).map_err(failed)
    }

    fn reorder(&mut self) -> Result<(), DeviceError> {
        self.trainer()?.reorder().map_err(failed)
    }

    fn splats(&mut self) -> Result<Splats, DeviceError> {
        self.trainer()?.download_splats().map_err(failed)
    }

    fn adam(&mut self) -> Result<AdamState, DeviceError> {
        self.trainer()?.download_adam().map_err(failed)
    }

    fn step(&mut self, looks: &[DeviceLook<'_>], settings: &DeviceStep<'_>) -> Result<(), DeviceError> {
        let looks: Vec<Look<'_>> = looks
            .iter()
            .map(|look| Look {
                camera: look.camera,
                exposure: look.exposure,
                ..Look::new(look.frame, look.view)
            })
            .collect();
        let settings = StepSettings {
            lambda_ssim: settings.lambda_ssim,
            rates: settings.rates,
            adam: settings.adam,
        };
        self.trainer()?.step_looks(&looks, &settings).map_err(failed)
    }

    fn found(&mut self) -> Result<DeviceFound, DeviceError> {
        let found = self.trainer()?.found().map_err(failed)?;
        Ok(DeviceFound {
            steps: found.steps,
            looks: found.looks,
            cameras: found.cameras,
            exposures: found.exposures,
            l1: if found.loss_is_finite { found.l1 } else { f64::NAN },
            ssim: found.ssim,
            psnr: found.psnr,
            touched: found.touched,
            splats_are_finite: found.splats_are_finite,
        })
    }

    fn score(&mut self, looks: &[(usize, View)], settings: &ScoreSettings) -> Result<Scores, DeviceError> {
        let sums = self
            .trainer()?
            .score(looks, &score_settings(settings))
            .map_err(failed)?;
        Ok(Scores {
            densify: sums.densify,
            prune: sums.prune,
        })
    }

    fn densify(&mut self, round: &DeviceRound<'_>) -> Result<Option<DensifyStats>, DeviceError> {
        let Rules {
            config,
            due,
            min_opacity,
            scale,
        } = round.rules;
        let trainer = self.trainer()?;
        let threshold = config.prune_threshold;
        let round = DensityRound {
            looks: round.looks,
            scores: score_settings(&round.scores),
            grow: due.densify.then(|| GrowRule {
                threshold: config.densify_threshold,
                budget: due.budget(config, trainer.n()),
            }),
            prune: due.prune_by_score.then_some(match config.prune_rule {
                PruneRule::Literal => m4_kernels::gpu::PruneRule::Literal { threshold },
                PruneRule::WithOpacity { opacity, quantile } => m4_kernels::gpu::PruneRule::WithOpacity {
                    threshold,
                    opacity,
                    quantile,
                },
            }),
            min_opacity,
            split_size: match config.split_size {
                SplitSize::Extent { share } => m4_kernels::gpu::SplitSize::Everywhere(share * scale.extent),
                SplitSize::Pixels { pixels } => m4_kernels::gpu::SplitSize::Pixels {
                    pixels,
                    focal_px: scale.focal_px,
                    centres: &scale.centres,
                },
            },
            share_opacity: config.clone_opacity == CloneOpacity::Share,
        };
        let grown = trainer.densify(&round).map_err(failed)?;
        if let Some(shape) = &mut self.shape {
            (shape.n_static, shape.n_dynamic) = (grown.n_static, grown.n_dynamic);
        }
        Ok(Some(DensifyStats {
            cloned: grown.cloned,
            split: grown.split,
            pruned: grown.pruned,
            n_static: grown.n_static,
            n_dynamic: grown.n_dynamic,
        }))
    }

    fn colour_gradient(&mut self, looks: &[(usize, View)], with_weight: bool) -> Result<ColourGradient, DeviceError> {
        let sums = self.trainer()?.colour_gradient(looks, with_weight).map_err(failed)?;
        Ok(ColourGradient {
            residual: sums.residual,
            weight: sums.weight,
            squares: sums.squares,
        })
    }
}
