//! One iteration.

use super::Trainer;
use crate::{
    TrainError, batch::add_touched, density::rearrange, metrics::psnr, rates::rates, refine::expose, schedule,
};
use m4_kernels::adam::cpu::{AdamState, step as adam_step};
use m4_kernels::loss::cpu::loss;
use m4_kernels::{Wanted, morton_order};

/// What an iteration found.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StepReport {
    pub loss: f64,
    /// Of the frame, dB; NaN unless an event is due.
    pub psnr: f64,
}

impl StepReport {
    /// Before the first step.
    pub(super) const NONE: Self = Self {
        loss: f64::NAN,
        psnr: f64::NAN,
    };
}

/// What drawing one frame found.
#[derive(Debug, Clone, Copy)]
struct Look {
    loss: f64,
    psnr: f64,
}

impl Trainer<'_> {
    /// Draws the frames of a step, compares, and moves every splat that was seen.
    pub(crate) fn step(&mut self) -> Result<StepReport, TrainError> {
        if self.good.is_none() {
            self.good = Some((self.iteration, self.splats.clone()));
        }
        let (i, n, batch) = (self.iteration, self.config.iterations, self.config.batch);
        let (mut total, mut last) = (0.0, f64::NAN);
        for k in 0..batch {
            let frame = self.picker.pick(i * batch + k);
            if k == 1 {
                // the first frame starts the sum; what comes back is written over
                std::mem::swap(&mut self.gradients, &mut self.batch_sum);
            }
            let look = self.look(frame)?;
            if k > 0 {
                add_touched(&mut self.batch_sum, &self.gradients, self.splats.n_static());
            }
            total += look.loss / batch as f64;
            last = look.psnr;
        }
        let gradients = if batch > 1 { &self.batch_sum } else { &self.gradients };
        let x = schedule::progress(i, n);
        let mut lr = rates(&self.config.lr, self.splats.layout(), &self.scale, self.basis, x);
        let faster = (batch as f32).sqrt();
        lr.iter_mut().for_each(|rate| *rate *= faster);
        adam_step(
            self.level,
            &mut self.splats,
            gradients,
            &mut self.adam,
            &self.config.adam,
            &lr,
        );
        self.totals.steps += 1;
        self.totals.touched += gradients.touched.iter().filter(|&&v| v != 0).count();

        self.iteration += 1;
        self.guard()?;
        self.density_round()?;
        let reorder = self.config.reorder_every;
        if reorder > 0 && self.iteration.is_multiple_of(reorder) {
            self.reorder()?;
        }
        if self.colours_are_due() {
            self.fit_colours();
            self.guard()?;
        }
        Ok(StepReport {
            loss: total,
            psnr: last,
        })
    }

    /// Draws a frame, compares, and leaves the gradients of the splats; cameras are corrected at once.
    fn look(&mut self, frame: usize) -> Result<Look, TrainError> {
        let (i, n) = (self.iteration, self.config.iterations);
        let refining = i >= self.config.refine.from;
        let exposing = self.config.refine.exposure && refining;

        let view = self.view(frame);
        let target = self.store.target(frame);
        let drawn = self.renderer.render(&self.splats, &view);
        let rgb = if self.config.refine.exposure {
            expose(&self.fit.frames[frame].exposure, &drawn.rgb, &mut self.exposed);
            &self.exposed
        } else {
            &drawn.rgb
        };
        let lambda = self.config.lambda_ssim;
        let out = &mut self.frame_gradient;
        let photo = loss(self.level, target, rgb, lambda, &mut self.photo, &mut out.rgb);
        let (done, every) = (i + 1, self.config.metrics_every);
        let psnr = if done.is_multiple_of(every) || done == n {
            psnr(rgb, &target.rgb())
        } else {
            f64::NAN
        };
        if exposing {
            self.fit
                .step_exposure(&self.config.refine, frame, &drawn.rgb, &mut out.rgb);
        }
        if !photo.total.is_finite() {
            return Err(self.back_to_good("the loss"));
        }

        let wanted = Wanted {
            camera: refining && (self.config.refine.poses || self.config.refine.focal),
            ..Wanted::default()
        };
        self.renderer.backward(&self.splats, out, wanted, &mut self.gradients);
        if wanted.camera {
            self.fit.step(
                &self.config.refine,
                frame,
                &view.camera,
                &self.gradients.camera,
                f64::from(self.scale.median_depth),
            );
        }
        let t = &mut self.totals;
        t.frames += 1;
        t.loss += photo.total;
        t.l1 += photo.l1;
        t.ssim += photo.ssim;
        Ok(Look {
            loss: photo.total,
            psnr,
        })
    }

    /// Prepares every image, so that steps cost what they cost after the first epoch.
    pub(crate) fn prepare_frames(&mut self) {
        self.store.prepare_all();
    }

    /// Lays splats and optimiser state out along a Morton curve.
    pub(super) fn reorder(&mut self) -> Result<(), TrainError> {
        let order = morton_order(&self.splats);
        self.splats.rearrange(&order)?;
        rearrange(&mut self.adam, &order)?;
        Ok(())
    }

    pub(super) fn guard_is_due(&self) -> bool {
        self.iteration.is_multiple_of(self.config.guard_every) || self.iteration == self.config.iterations
    }

    /// Keeps the splats if they are finite, and goes back to those kept if they are not; now and then.
    pub(super) fn guard(&mut self) -> Result<(), TrainError> {
        if !self.guard_is_due() {
            return Ok(());
        }
        if !self.splats.is_finite() {
            return Err(self.back_to_good("a parameter of a splat"));
        }
        if let Some((iteration, splats)) = &mut self.good {
            *iteration = self.iteration;
            splats.clone_from(&self.splats);
        }
        Ok(())
    }

    pub(super) fn back_to_good(&mut self, what: &'static str) -> TrainError {
        let iteration = self.iteration;
        if let Some((good, splats)) = self.good.take() {
            // without the moments, which led here, and without a device that has others
            self.gpu = None;
            self.adam = AdamState::new(&splats);
            (self.iteration, self.splats) = (good, splats);
        }
        TrainError::Diverged {
            what,
            iteration,
            good_iteration: self.iteration,
        }
    }
}
