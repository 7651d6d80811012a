//! Runs of steps, and who is at fault where they diverge.

use super::{Outcome, Trainer};
use crate::{MetricsEvent, TrainError};
use cpu_time::ProcessTime;
use m4_core::Progress;
use std::time::Instant;

impl Trainer<'_> {
    /// Trains to the last iteration of the settings and fits the colours, see
    /// [`run_until`](Self::run_until). Fails as [`run_until`](Self::run_until).
    pub fn run(
        &mut self,
        progress: &dyn Progress,
        metrics: &mut dyn FnMut(&MetricsEvent),
    ) -> Result<Outcome, TrainError> {
        self.run_until(self.config.iterations, progress, metrics)
    }

    /// Trains until `iteration` steps are taken in all (at most those of the settings): for saving
    /// in between. `metrics` gets an event every [`crate::TrainConfig::metrics_every`] steps and at
    /// the end. Fails with [`TrainError::Diverged`] when the loss or a parameter is no longer
    /// finite; the trainer then has the last splats that were, and an optimiser that starts from
    /// nothing. [`TrainError::Device`] when a device failed, likewise.
    ///
    /// Where another device than the CPU diverges, the CPU repeats the steps since the last good
    /// splats. If it does not diverge, the device is at fault: [`TrainError::Device`], and the
    /// trainer has the splats of the CPU.
    pub fn run_until(
        &mut self,
        iteration: usize,
        progress: &dyn Progress,
        metrics: &mut dyn FnMut(&MetricsEvent),
    ) -> Result<Outcome, TrainError> {
        let outcome = self.steps_until(iteration, progress, metrics);
        let Err(TrainError::Diverged {
            what,
            iteration: at,
            good_iteration,
        }) = outcome
        else {
            return outcome;
        };
        if !self.is_device {
            return outcome;
        }
        progress.warn(&format!(
            "{what} is NaN or infinite on the GPU at iteration {at}; the CPU repeats the steps since iteration {good_iteration}"
        ));
        self.use_cpu(self.level)?;
        match self.steps_until(at.max(good_iteration + 1), progress, metrics)? {
            Outcome::Finished => Err(TrainError::Device {
                why: format!(
                    "the GPU computed {what} as NaN or infinite, which the CPU does not: the device or its driver is at fault"
                ),
                iteration: at,
                good_iteration: self.iteration,
            }),
            stopped => Ok(stopped),
        }
    }

    fn steps_until(
        &mut self,
        iteration: usize,
        progress: &dyn Progress,
        metrics: &mut dyn FnMut(&MetricsEvent),
    ) -> Result<Outcome, TrainError> {
        let end = iteration.min(self.config.iterations);
        while self.iteration < end {
            if progress.cancelled() {
                self.synchronize()?;
                return Ok(Outcome::Stopped {
                    iteration: self.iteration,
                });
            }
            let (started, processor) = (Instant::now(), ProcessTime::try_now());
            self.step()?;
            // where it costs waiting, the backend is asked for events only
            let due = self.event_is_due(end) || self.backend.is_synchronous();
            let report = due.then(|| self.report()).transpose()?;
            self.seconds += started.elapsed().as_secs_f64();
            let spent = processor.and_then(|start| start.try_elapsed());
            self.processor_seconds += spent.unwrap_or_default().as_secs_f64();
            let done = self.iteration;
            if let Some(report) = report.filter(|_| self.event_is_due(end)) {
                metrics(&self.event(report.psnr));
            }
            if done.is_multiple_of(10) || done == end {
                let splats = self.counts.0 + self.counts.1;
                let note = match report {
                    Some(report) => format!("loss {:.4}, {splats} splats", report.loss),
                    None => format!("{splats} splats"),
                };
                progress.update("train", done, self.config.iterations, &note);
            }
        }
        if self.iteration == self.config.iterations
            && !self.is_fitted
            && !self.fit_colours(progress)?
        {
            self.synchronize()?;
            return Ok(Outcome::Stopped {
                iteration: self.iteration,
            });
        }
        self.synchronize()?;
        Ok(Outcome::Finished)
    }

    fn event_is_due(&self, end: usize) -> bool {
        self.iteration.is_multiple_of(self.config.metrics_every) || self.iteration == end
    }

    fn event(&mut self, psnr: f64) -> MetricsEvent {
        let t = std::mem::take(&mut self.totals);
        let n = t.frames.max(1) as f64;
        let (splats_static, splats_dynamic) = self.counts;
        MetricsEvent {
            iteration: self.iteration,
            loss: t.loss / n,
            l1: t.l1 / n,
            ssim: t.ssim / n,
            psnr,
            splats_static,
            splats_dynamic,
            touched: t.touched as f64 / t.steps.max(1) as f64,
            seconds: self.seconds,
            processor_seconds: self.processor_seconds,
        }
    }
}
