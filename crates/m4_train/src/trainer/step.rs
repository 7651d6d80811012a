//! One iteration, the same for every backend.

use super::{Trainer, place};
use crate::{
    TrainError,
    backend::{Backend, BackendError, StepSettings, StepView},
    frames::targets,
    schedule,
    schedule::{node_rates, rates},
};
use m4_core::Exposure;
use m4_kernels::{
    View,
    adam::{FIXED, cpu::AdamState},
};
use std::time::{Duration, Instant};

/// What the last steps found.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StepReport {
    /// Mean over the frames.
    pub loss: f64,
    /// Of the last frame, dB; NaN from a backend that measures it for events alone.
    pub psnr: f64,
}

impl StepReport {
    /// Before the first step.
    pub(super) const NONE: Self = Self {
        loss: f64::NAN,
        psnr: f64::NAN,
    };
}

impl Trainer<'_> {
    /// Draws the frames of a step, compares, moves every splat that was seen, and does what is due
    /// after it.
    pub(crate) fn step(&mut self) -> Result<(), TrainError> {
        let (i, n, batch) = (self.iteration, self.config.iterations, self.config.batch);
        let frames: Vec<usize> = (0..batch)
            .map(|k| self.picker.pick(i * batch + k))
            .collect();
        if frames.iter().any(|frame| self.pending.contains(frame)) {
            self.settle()?;
        }
        self.degree_round()?;
        self.prepare()?;
        let views: Vec<View> = frames.iter().map(|&f| self.view(f)).collect();
        let x = schedule::progress(i, n);
        let mut lr = rates(
            &self.config.lr,
            self.splats.layout(),
            &self.scale,
            self.basis,
            x,
        );
        let faster = (batch as f32).sqrt();
        lr.iter_mut().for_each(|rate| *rate *= faster);
        let mut nodes = node_rates(&self.config.lr, &self.scale, x);
        (nodes.position, nodes.turn) = (nodes.position * faster, nodes.turn * faster);
        let refine = &self.config.refine;
        let refining = i >= refine.from;
        let (camera, exposure) = (
            refining && (refine.poses || refine.focal),
            refining && refine.exposure,
        );
        let views: Vec<StepView<'_>> = frames
            .iter()
            .zip(&views)
            .map(|(&frame, view)| StepView {
                frame,
                view,
                camera,
                exposure,
            })
            .collect();
        let settings = StepSettings {
            lambda_ssim: self.config.lambda_ssim,
            cover: if self.scale.one_centre {
                self.config.cover
            } else {
                0.0
            },
            rates: &lr,
            nodes,
            adam: self.config.adam,
            psnr: (i + 1).is_multiple_of(self.config.metrics_every) || i + 1 == n,
        };
        self.ask(|backend| backend.step(&views, &settings))?;
        self.is_current = false;
        if camera || exposure {
            self.pending.extend(&frames);
        }
        // all frames share the focal length
        if (camera && self.config.refine.focal) || self.backend.is_synchronous() {
            self.report()?;
        }

        self.iteration += 1;
        self.guard()?;
        self.density_round()?;
        Ok(())
    }

    /// Waits for the backend, adds its statistics to the totals, corrects cameras and exposures,
    /// and returns loss and PSNR.
    pub(crate) fn report(&mut self) -> Result<StepReport, TrainError> {
        let stats = self.ask(|backend| backend.stats())?;
        self.pending.clear();
        if stats.steps == 0 {
            return Ok(self.last);
        }
        let lambda = f64::from(self.config.lambda_ssim);
        let loss = (1.0 - lambda) * stats.l1 + lambda * (1.0 - stats.ssim);
        if !loss.is_finite() {
            return Err(self.back_to_good("the loss"));
        }
        if !stats.splats_are_finite {
            return Err(self.back_to_good("a parameter of a splat"));
        }
        let (t, steps, frames) = (&mut self.totals, stats.steps as f64, stats.frames as f64);
        t.frames += stats.frames;
        t.steps += stats.steps;
        t.loss += loss * frames;
        t.l1 += stats.l1 * frames;
        t.ssim += stats.ssim * frames;
        t.touched += (stats.touched * steps).round() as usize;
        for (frame, gradient) in stats.exposures {
            self.fit.step_exposure(&self.config.refine, frame, gradient);
        }
        for (frame, gradient) in &stats.cameras {
            let drawn = self.fit.camera(*frame);
            let median_depth = f64::from(self.scale.median_depth);
            self.fit
                .step(&self.config.refine, *frame, &drawn, gradient, median_depth);
        }
        self.last = StepReport {
            loss,
            psnr: stats.psnr,
        };
        Ok(self.last)
    }

    /// Corrects the cameras and exposures of all frames drawn so far: before one of them is drawn
    /// again, or saved.
    pub(super) fn settle(&mut self) -> Result<(), TrainError> {
        if !self.pending.is_empty() {
            self.report()?;
        }
        Ok(())
    }

    /// Frames, splats and exposures are on the backend: before anything is drawn.
    pub(super) fn prepare(&mut self) -> Result<(), TrainError> {
        if let Some(capture) = self.frames_wanted.take() {
            self.ask(|backend| backend.set_frames(targets(capture)))?;
        }
        if !self.is_uploaded {
            let nothing = AdamState::new(&self.splats.gather(&[])?);
            let adam = std::mem::replace(&mut self.adam, nothing);
            self.good = self.iteration;
            let uploaded = self.backend.upload(&self.splats, adam);
            uploaded.map_err(|error| self.backend_failed(&error))?;
            (self.is_uploaded, self.is_current) = (true, true);
            self.counts = (self.splats.n_static(), self.splats.n_dynamic());
        }
        if self.config.refine.exposure {
            let exposures: Vec<Exposure> = self.fit.frames.iter().map(|f| f.exposure).collect();
            self.ask(|backend| backend.set_exposures(&exposures))?;
        }
        Ok(())
    }

    /// Lays splats and the optimiser's state out along a Morton curve.
    pub(super) fn reorder(&mut self) -> Result<(), TrainError> {
        self.ask(|backend| backend.reorder())?;
        self.is_current = false;
        Ok(())
    }

    /// Checks now and then that everything is finite, and keeps the splats if so. A backend that
    /// must be waited for is not asked for them more often than the settings say; which of the
    /// finite states is kept changes nothing in a run that does not fail.
    fn guard(&mut self) -> Result<(), TrainError> {
        let last = self.iteration == self.config.iterations;
        if !last && !self.iteration.is_multiple_of(self.config.guard_every) {
            return Ok(());
        }
        self.report()?;
        let pause = Duration::try_from_secs_f32(self.config.keep_every_s).unwrap_or(Duration::MAX);
        if !last && !self.backend.is_synchronous() && self.saved.elapsed() < pause {
            return Ok(());
        }
        self.download()?;
        self.saved = Instant::now();
        Ok(())
    }

    /// The splats here become those of the backend, if they are finite.
    pub(super) fn download(&mut self) -> Result<(), TrainError> {
        if !self.is_current {
            let splats = self.ask(|backend| backend.splats())?;
            if !splats.is_finite() {
                return Err(self.back_to_good("a parameter of a splat"));
            }
            (self.splats, self.good, self.is_current) = (splats, self.iteration, true);
        }
        Ok(())
    }

    /// Brings everything back from the backend.
    /// Fails with [`TrainError::Device`] if it failed; the trainer then has the last good splats.
    pub(super) fn synchronize(&mut self) -> Result<(), TrainError> {
        if self.is_uploaded {
            self.settle()?;
            let (splats, adam) = self.ask(|backend| backend.take())?;
            self.is_uploaded = false;
            if !splats.is_finite() {
                return Err(self.back_to_good("a parameter of a splat"));
            }
            (self.splats, self.adam) = (splats, adam);
            (self.good, self.is_current) = (self.iteration, true);
        }
        Ok(())
    }

    /// Asks the backend for something; where it fails the trainer goes back to its last good
    /// splats.
    pub(super) fn ask<R>(
        &mut self,
        ask: impl FnOnce(&mut dyn Backend) -> Result<R, BackendError>,
    ) -> Result<R, TrainError> {
        let answer = ask(self.backend.as_mut());
        answer.map_err(|error| self.backend_failed(&error))
    }

    fn backend_failed(&mut self, error: &BackendError) -> TrainError {
        let iteration = self.iteration;
        self.go_back();
        TrainError::Device {
            why: error.to_string(),
            iteration,
            good_iteration: self.iteration,
        }
    }

    fn back_to_good(&mut self, what: &'static str) -> TrainError {
        let iteration = self.iteration;
        self.go_back();
        TrainError::Diverged {
            what,
            iteration,
            good_iteration: self.iteration,
        }
    }

    /// Goes back to the splats here, without the moments, which led to the failure.
    fn go_back(&mut self) {
        self.adam = AdamState::new(&self.splats);
        for (row, step) in self.adam.step.iter_mut().enumerate() {
            if self.fixed.contains(&place(&self.splats, row)) {
                *step = FIXED;
            }
        }
        self.iteration = self.good;
        (self.is_uploaded, self.is_current) = (false, true);
        self.counts = (self.splats.n_static(), self.splats.n_dynamic());
        self.last = StepReport::NONE;
        self.pending.clear();
    }
}
