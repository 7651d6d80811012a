//! A backend that counts what it is asked for, fails, or breaks a splat.

use m4_core::{Column, Exposure, Splats};
use m4_kernels::{StepStats, View, adam::cpu::AdamState, loss::cpu::Target};
use m4_train::{
    Backend, BackendError,
    backend::{ColourSums, StepSettings, StepView},
    density::{DensityRound, DensityStats},
};
use std::sync::{
    Arc,
    atomic::{AtomicUsize, Ordering},
};

/// How often a backend was asked for something.
#[derive(Debug, Default)]
pub struct Calls {
    /// For a round of density control.
    pub rounds: AtomicUsize,
    /// For statistics, which waits for all steps.
    pub waits: AtomicUsize,
}

/// Another backend, as one that must be waited for.
#[derive(Debug)]
pub struct Watched<'a> {
    inner: Box<dyn Backend + 'a>,
    calls: Arc<Calls>,
    steps: usize,
    /// The step that fails.
    pub fails_at: usize,
    /// A splat is NaN after this step.
    pub breaks_at: usize,
}

impl<'a> Watched<'a> {
    /// Counts into `calls`.
    pub fn new(inner: Box<dyn Backend + 'a>, calls: &Arc<Calls>) -> Self {
        Self {
            inner,
            calls: Arc::clone(calls),
            steps: 0,
            fails_at: 0,
            breaks_at: 0,
        }
    }
}

impl Backend for Watched<'_> {
    fn name(&self) -> String {
        self.inner.name()
    }

    fn is_synchronous(&self) -> bool {
        false
    }

    fn set_frames(&mut self, frames: Vec<Target>) -> Result<(), BackendError> {
        self.inner.set_frames(frames)
    }

    fn set_exposures(&mut self, exposures: &[Exposure]) -> Result<(), BackendError> {
        self.inner.set_exposures(exposures)
    }

    fn upload(&mut self, splats: &Splats, adam: AdamState) -> Result<(), BackendError> {
        self.inner.upload(splats, adam)
    }

    fn take(&mut self) -> Result<(Splats, AdamState), BackendError> {
        self.inner.take()
    }

    fn splats(&mut self) -> Result<Splats, BackendError> {
        self.inner.splats()
    }

    fn set_splats(&mut self, splats: &Splats) -> Result<(), BackendError> {
        self.inner.set_splats(splats)
    }

    fn reorder(&mut self) -> Result<(), BackendError> {
        self.inner.reorder()
    }

    fn step(
        &mut self,
        views: &[StepView<'_>],
        settings: &StepSettings<'_>,
    ) -> Result<(), BackendError> {
        self.steps += 1;
        if self.steps == self.fails_at {
            return Err(BackendError("the backend broke".to_owned()));
        }
        self.inner.step(views, settings)?;
        if self.steps == self.breaks_at {
            let mut splats = self.inner.splats()?;
            splats.column_mut(Column::Opacity, 0)[0] = f32::NAN;
            self.inner.set_splats(&splats)?;
        }
        Ok(())
    }

    fn stats(&mut self) -> Result<StepStats, BackendError> {
        self.calls.waits.fetch_add(1, Ordering::Relaxed);
        let splats_are_finite = self.inner.splats()?.is_finite();
        Ok(StepStats {
            splats_are_finite,
            ..self.inner.stats()?
        })
    }

    fn collect_image_gradients(&mut self) {
        self.inner.collect_image_gradients();
    }

    fn densify(&mut self, round: &DensityRound<'_>) -> Result<DensityStats, BackendError> {
        self.calls.rounds.fetch_add(1, Ordering::Relaxed);
        self.inner.densify(round)
    }

    fn colour_sums(
        &mut self,
        views: &[(usize, View)],
        with_weight: bool,
        stop: &dyn Fn() -> bool,
    ) -> Result<ColourSums, BackendError> {
        self.inner.colour_sums(views, with_weight, stop)
    }
}
