//! Training on a device: the state on the host, and its synchronisation with the device.
//!
//! Splats and optimiser state are on the device while it steps and grows and prunes; those here are as old as the last time
//! the host needed them: the guard now and then, a checkpoint, density control where the device leaves it to the
//! processor. `host_stale` and `adam_stale` say so.

mod density;

use super::Trainer;
use super::step::StepReport;
use crate::{
    TrainError,
    colour_fit::ColourSums,
    device::{DensifyPlan, Device, DeviceError, DeviceFound, DeviceLook, DeviceStep},
    rates::rates,
    schedule,
};
use m4_core::Exposure;
use m4_kernels::View;
use std::time::{Duration, Instant};

/// A device and how far it is from what the trainer holds.
#[derive(Debug)]
pub(super) struct GpuBackend {
    device: Box<dyn Device>,
    /// It has the frames.
    has_frames: bool,
    /// It has the splats and the state of the trainer, or newer ones.
    has_splats: bool,
    host_stale: bool,
    adam_stale: bool,
    /// Static and dynamic splats there, where those here are old and another number.
    counts: Option<(usize, usize)>,
    /// When splats were kept to go back to.
    kept: Instant,
    /// What the last steps found.
    last: StepReport,
}

impl GpuBackend {
    fn new(device: Box<dyn Device>) -> Self {
        Self {
            device,
            has_frames: false,
            has_splats: false,
            host_stale: false,
            adam_stale: false,
            counts: None,
            kept: Instant::now(),
            last: StepReport::NONE,
        }
    }
}

impl Trainer<'_> {
    /// Takes steps on `device` from here on. The result depends on it as on a SIMD level: the same device gives the
    /// same bits, another one last digits of its own.
    /// With corrections of cameras or exposures every step waits for the device.
    pub fn use_device(&mut self, device: Box<dyn Device>) {
        self.gpu = Some(GpuBackend::new(device));
    }

    /// Waits for the device and brings everything back; nothing to do on the processor.
    ///
    /// # Errors
    ///
    /// [`TrainError::Device`] if it failed; the trainer then has the last splats that were looked at.
    pub(super) fn synchronize(&mut self) -> Result<(), TrainError> {
        self.download_splats()?;
        let Some(gpu) = self.gpu.as_mut().filter(|r| r.adam_stale) else {
            return Ok(());
        };
        match gpu.device.adam() {
            Ok(adam) => {
                gpu.adam_stale = false;
                self.adam = adam;
                Ok(())
            }
            Err(error) => Err(self.device_failed(&error)),
        }
    }

    /// One iteration on the device.
    pub(crate) fn gpu_step(&mut self) -> Result<(), TrainError> {
        let (i, n) = (self.iteration, self.config.iterations);
        self.prepare_remote()?;
        let batch = self.config.batch;
        let frames: Vec<usize> = (0..batch).map(|k| self.picker.pick(i * batch + k)).collect();
        let views: Vec<View> = frames.iter().map(|&f| self.view(f)).collect();
        let x = schedule::progress(i, n);
        let mut lr = rates(&self.config.lr, self.splats.layout(), &self.scale, self.basis, x);
        let faster = (batch as f32).sqrt();
        lr.iter_mut().for_each(|rate| *rate *= faster);
        let refine = &self.config.refine;
        let refining = i >= refine.from;
        let (camera, exposure) = (refining && (refine.poses || refine.focal), refining && refine.exposure);
        let looks: Vec<DeviceLook<'_>> = frames
            .iter()
            .zip(&views)
            .map(|(&frame, view)| DeviceLook {
                frame,
                view,
                camera,
                exposure,
            })
            .collect();
        let settings = DeviceStep {
            lambda_ssim: self.config.lambda_ssim,
            rates: &lr,
            adam: self.config.adam,
        };
        self.on_gpu(|device| device.step(&looks, &settings))?;
        if let Some(gpu) = &mut self.gpu {
            (gpu.host_stale, gpu.adam_stale) = (true, true);
        }
        if camera || exposure {
            // they are corrected before they are used again
            self.look_at_remote()?;
        }
        self.iteration += 1;

        if self.guard_is_due() {
            self.guard_on_gpu()?;
        }
        self.density_round()?;
        let reorder = self.config.reorder_every;
        if reorder > 0 && self.iteration.is_multiple_of(reorder) {
            self.reorder_on_gpu()?;
        }
        if self.colours_are_due() {
            self.fit_colours_on_gpu()?;
            self.guard()?;
        }
        Ok(())
    }

    /// Static and dynamic splats, wherever they are.
    pub(super) fn counts(&self) -> (usize, usize) {
        let there = self.gpu.as_ref().and_then(|r| r.counts);
        there.unwrap_or((self.splats.n_static(), self.splats.n_dynamic()))
    }

    /// The guard, on the device. What is gone back to comes here at the end, and else not more often than the settings
    /// say; which of the finite states that is changes nothing in a run that does not fail.
    fn guard_on_gpu(&mut self) -> Result<(), TrainError> {
        self.look_at_remote()?;
        let pause = Duration::try_from_secs_f32(self.config.keep_every_s).unwrap_or(Duration::MAX);
        let last = self.iteration == self.config.iterations;
        if !last && self.gpu.as_ref().is_some_and(|r| r.kept.elapsed() < pause) {
            return Ok(());
        }
        self.download_splats()?;
        self.guard()?;
        if let Some(gpu) = &mut self.gpu {
            gpu.kept = Instant::now();
        }
        Ok(())
    }

    /// Waits for the device, adds what it found to the totals, and returns loss and PSNR.
    pub(crate) fn look_at_remote(&mut self) -> Result<StepReport, TrainError> {
        let found: DeviceFound = self.on_gpu(|device| device.found())?;
        if found.steps == 0 {
            return Ok(self.gpu.as_ref().map_or(StepReport::NONE, |r| r.last));
        }
        let lambda = f64::from(self.config.lambda_ssim);
        let loss = (1.0 - lambda) * found.l1 + lambda * (1.0 - found.ssim);
        if !loss.is_finite() {
            return Err(self.back_to_good("the loss"));
        }
        if !found.splats_are_finite {
            return Err(self.back_to_good("a parameter of a splat"));
        }
        let (t, steps, looks) = (&mut self.totals, found.steps as f64, found.looks as f64);
        t.frames += found.looks;
        t.steps += found.steps;
        t.loss += loss * looks;
        t.l1 += found.l1 * looks;
        t.ssim += found.ssim * looks;
        t.touched += (found.touched * steps).round() as usize;
        for (frame, gradient) in found.exposures {
            self.fit.step_exposure_along(&self.config.refine, frame, gradient);
        }
        for (frame, gradient) in &found.cameras {
            let drawn = self.fit.camera(*frame);
            let median_depth = f64::from(self.scale.median_depth);
            self.fit
                .step(&self.config.refine, *frame, &drawn, gradient, median_depth);
        }
        let report = StepReport { loss, psnr: found.psnr };
        if let Some(gpu) = &mut self.gpu {
            gpu.last = report;
        }
        Ok(report)
    }

    /// Frames and splats are there: before anything is drawn.
    fn prepare_remote(&mut self) -> Result<(), TrainError> {
        if self.good.is_none() {
            self.good = Some((self.iteration, self.splats.clone()));
        }
        let Some(gpu) = &mut self.gpu else { return Ok(()) };
        let mut done = Ok(());
        if !gpu.has_frames {
            done = gpu.device.set_frames(self.store.hand_over());
            gpu.has_frames = true;
        }
        if done.is_ok() && !gpu.has_splats {
            done = gpu.device.upload(&self.splats, &self.adam);
            gpu.has_splats = true;
        }
        if done.is_ok() && self.config.refine.exposure {
            let exposures: Vec<Exposure> = self.fit.frames.iter().map(|f| f.exposure).collect();
            done = gpu.device.set_exposures(&exposures);
        }
        done.map_err(|error| self.device_failed(&error))
    }

    /// The splats here are those there.
    pub(super) fn download_splats(&mut self) -> Result<(), TrainError> {
        let Some(gpu) = self.gpu.as_mut().filter(|r| r.host_stale) else {
            return Ok(());
        };
        match gpu.device.splats() {
            Ok(splats) => {
                (gpu.host_stale, gpu.counts) = (false, None);
                self.splats = splats;
                Ok(())
            }
            Err(error) => Err(self.device_failed(&error)),
        }
    }

    /// Lays everything there out along a Morton curve; what is here has another order then.
    fn reorder_on_gpu(&mut self) -> Result<(), TrainError> {
        self.on_gpu(|device| device.reorder())?;
        if let Some(gpu) = &mut self.gpu {
            (gpu.host_stale, gpu.adam_stale) = (true, true);
        }
        Ok(())
    }

    /// As `fit_colours`, with the sums made on the device.
    fn fit_colours_on_gpu(&mut self) -> Result<(), TrainError> {
        let looks: Vec<(usize, View)> = (0..self.times.len()).map(|frame| (frame, self.view(frame))).collect();
        self.prepare_remote()?;
        self.download_splats()?;
        let n = self.splats.n();
        let (rows, is_new): (Vec<u32>, _) = ((0..n as u32).collect(), vec![false; n]);
        let mut sums = ColourSums::new(n);
        for round in 0..self.config.colour_fit_rounds {
            let found = self.on_gpu(|device| device.colour_gradient(&looks, round == 0))?;
            sums.replace(found.residual, found.weight);
            sums.apply(&mut self.splats);
            let values = self.splats.clone();
            self.on_gpu(|device| {
                device.regrow(&DensifyPlan {
                    rows: &rows,
                    n_static: values.n_static(),
                    is_new: &is_new,
                    changed: &rows,
                    values: &values,
                })
            })?;
        }
        Ok(())
    }

    /// Asks the device for something; where it fails the trainer goes back to its last good splats.
    fn on_gpu<R>(&mut self, ask: impl FnOnce(&mut dyn Device) -> Result<R, DeviceError>) -> Result<R, TrainError> {
        let Some(gpu) = &mut self.gpu else {
            // callers ask for a device before they come here
            return Err(self.device_failed(&DeviceError("there is no device".to_owned())));
        };
        let answer = ask(gpu.device.as_mut());
        answer.map_err(|error| self.device_failed(&error))
    }

    /// Leaves the device as it is and goes back to the last good splats.
    fn device_failed(&mut self, error: &DeviceError) -> TrainError {
        let iteration = self.iteration;
        // what is kept is what is here now
        self.back_to_good("the device");
        TrainError::Device {
            why: error.to_string(),
            iteration,
            good_iteration: self.iteration,
        }
    }
}
