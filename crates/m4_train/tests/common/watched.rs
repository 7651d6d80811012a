//! A backend that fails, breaks a splat, or leaves density control to the trainer.

use m4_core::{Column, Exposure, Splats};
use m4_kernels::adam::cpu::AdamState;
use m4_kernels::loss::cpu::Target;
use m4_kernels::{StepStats, View};
use m4_train::backend::{ColourSums, DensityRound, DensityStats, ScoreSettings, StepSettings, StepView};
use m4_train::density::Scores;
use m4_train::{Backend, BackendError};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Another backend, as one that must be waited for.
#[derive(Debug)]
pub struct Watched<'a> {
    inner: Box<dyn Backend + 'a>,
    /// Counts the rounds of density control; `None` leaves them to the trainer.
    rounds: Option<Arc<AtomicUsize>>,
    steps: usize,
    /// The step that fails.
    pub fails_at: usize,
    /// A splat is NaN after this step.
    pub breaks_at: usize,
}

impl<'a> Watched<'a> {
    pub fn new(inner: Box<dyn Backend + 'a>, rounds: Option<&Arc<AtomicUsize>>) -> Self {
        Self { inner, rounds: rounds.cloned(), steps: 0, fails_at: 0, breaks_at: 0 }
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

    fn step(&mut self, views: &[StepView<'_>], settings: &StepSettings<'_>) -> Result<(), BackendError> {
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
        let splats_are_finite = self.inner.splats()?.is_finite();
        Ok(StepStats { splats_are_finite, ..self.inner.stats()? })
    }

    fn score(&mut self, views: &[(usize, View)], settings: &ScoreSettings) -> Result<Scores, BackendError> {
        self.inner.score(views, settings)
    }

    fn densify(&mut self, round: &DensityRound<'_>) -> Result<Option<DensityStats>, BackendError> {
        let Some(rounds) = &self.rounds else { return Ok(None) };
        rounds.fetch_add(1, Ordering::Relaxed);
        self.inner.densify(round)
    }

    fn colour_sums(&mut self, views: &[(usize, View)], with_weight: bool) -> Result<ColourSums, BackendError> {
        self.inner.colour_sums(views, with_weight)
    }
}
