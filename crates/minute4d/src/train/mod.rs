//! Trains a scene from a capture.

mod timer;

use crate::device::OpenGpu;
use crate::observer::check_stop;
use crate::{Error, Observer, Settings, StageEvent};
use m4_core::{Capture, Progress, Scene, SplatLayout};
use m4_kernels::SimdLevel;
use m4_train::init::{FirstSplats, InitError};
use m4_train::{
    BackendError, BackendMaker, MetricsEvent, Outcome, TrainConfig, TrainError, Trainer,
};
use std::thread::ScopedJoinHandle;
use std::time::Instant;
use timer::CheckpointTimer;

/// Name of the stage.
pub const STAGE: &str = "train";

/// How a scene is trained.
#[derive(Debug, Clone)]
pub struct Training<'a> {
    /// Settings of the first splats and of training.
    pub settings: &'a Settings,
    /// Vector instructions.
    pub level: SimdLevel,
    /// The GPU to train on; `None` for the CPU. `None`, too, after a GPU that nobody asked for has
    /// failed.
    pub gpu: Option<OpenGpu>,
    /// Most memory on the GPU, megabytes.
    pub max_vram_mb: Option<usize>,
    /// Ends training early.
    pub end: Option<Instant>,
}

/// Where the state of a training is kept, so that an interrupted one continues.
pub trait TrainStore {
    /// Returns a trainer that continues from the newest state that is whole.
    ///
    /// # Errors
    ///
    /// [`Error`] where a state that can be read does not fit the capture.
    fn resume<'c>(
        &mut self,
        capture: &'c Capture,
        config: &TrainConfig,
        level: SimdLevel,
        progress: &dyn Progress,
    ) -> Result<Option<Trainer<'c>>, Error>;

    /// Prepares for a training from the start.
    ///
    /// # Errors
    ///
    /// [`Error::Write`].
    fn begin(&mut self) -> Result<(), Error>;

    /// Takes note of an event, which counts once it is saved.
    fn event(&mut self, event: &MetricsEvent);

    /// Saves the state; also when training is done, but for the state of `trainer` then.
    ///
    /// # Errors
    ///
    /// [`Error::Write`].
    fn save(&mut self, trainer: &mut Trainer<'_>) -> Result<(), Error>;

    /// Takes note that training is done.
    ///
    /// # Errors
    ///
    /// [`Error::Write`].
    fn finish(&mut self, trainer: &Trainer<'_>) -> Result<(), Error>;

    /// Takes note that training continues on the CPU.
    fn left_gpu(&mut self);
}

/// Keeps nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Forget;

impl TrainStore for Forget {
    fn resume<'c>(
        &mut self,
        _: &'c Capture,
        _: &TrainConfig,
        _: SimdLevel,
        _: &dyn Progress,
    ) -> Result<Option<Trainer<'c>>, Error> {
        Ok(None)
    }

    fn begin(&mut self) -> Result<(), Error> {
        Ok(())
    }

    fn event(&mut self, _: &MetricsEvent) {}

    fn save(&mut self, _: &mut Trainer<'_>) -> Result<(), Error> {
        Ok(())
    }

    fn finish(&mut self, _: &Trainer<'_>) -> Result<(), Error> {
        Ok(())
    }

    fn left_gpu(&mut self) {}
}

/// Trains a scene on `capture`, or continues what `store` has.
///
/// # Errors
///
/// [`Error`]: the capture cannot be used, training diverged, a GPU that was asked for failed, the state cannot be saved, or a stop was
/// requested, after the state was saved.
pub fn compute(
    capture: &Capture,
    training: &mut Training<'_>,
    store: &mut dyn TrainStore,
    observer: &dyn Observer,
) -> Result<Scene, Error> {
    let started = Instant::now();
    let settings = training.settings;
    let (level, max_vram_mb, end) = (training.level, training.max_vram_mb, training.end);
    let gpu = training.gpu.clone();
    let make = || match &gpu {
        Some(gpu) => Ok(gpu.training(max_vram_mb, &settings.train_config())),
        None => Err(BackendError("no GPU was started".to_owned())),
    };
    let mut config = settings.train_config();
    let mut trainer = match store.resume(capture, &config, level, observer)? {
        Some(trainer) => {
            let (done, total) = (trainer.iteration(), trainer.iterations());
            observer.stage(STAGE, StageEvent::Resumed { done, total });
            trainer
        }
        None => {
            store.begin()?;
            let first = first_splats(training, capture, observer)?;
            let budget_s = settings.train.budget_s;
            if budget_s > 0.0 || end.is_some() {
                let seconds = || affordable(budget_s, started, end);
                let stopped = || observer.cancelled();
                let fitting = |trial| {
                    let splats = &first.splats;
                    m4_train::affordable_iterations(
                        capture, splats, &config, level, trial, seconds, &stopped,
                    )
                };
                let n = match fitting(training.gpu.as_ref().map(|_| &make as BackendMaker<'_>)) {
                    Err(error) if may_leave_gpu(training, &error) => {
                        leave_gpu(training, store, observer, &error);
                        fitting(None)
                    }
                    // The training finds out whose fault that is.
                    Err(TrainError::Diverged { .. }) if training.gpu.is_some() => fitting(None),
                    other => other,
                }?;
                check_stop(observer, STAGE, true)?;
                if budget_s > 0.0 || n < config.iterations {
                    config.iterations = n;
                    let note = format!(
                        "{n} iterations fit into {:.0} s here; to ask for {n} repeats this run",
                        seconds()
                    );
                    observer.update(STAGE, 0, n, &note);
                }
            }
            let mut trainer = Trainer::new(capture, first, config, level)?;
            // The number of iterations may have been measured: a run resumed after a kill uses the
            // same.
            store.save(&mut trainer)?;
            trainer
        }
    };
    if let Some(gpu) = &training.gpu {
        trainer.use_backend(gpu.training(max_vram_mb, &settings.train_config()))?;
    }
    let total = trainer.iterations();
    let every_s = settings.checkpoint.every_s;
    let mut timer = CheckpointTimer::new(observer, every_s).at_most(end);
    loop {
        let mut note = |event: &MetricsEvent| {
            store.event(event);
            observer.metrics(event, total);
        };
        // After the last step comes the fit of colours, which starts anew when it is interrupted:
        // only the user stops it.
        let steps_are_done = trainer.iteration() == total;
        let progress: &dyn Progress = if steps_are_done { observer } else { &timer };
        let outcome = match trainer.run(progress, &mut note) {
            Ok(outcome) => outcome,
            Err(error) if may_leave_gpu(training, &error) => {
                leave_gpu(training, store, observer, &error);
                trainer.use_cpu(level)?;
                continue;
            }
            Err(error @ (TrainError::Diverged { .. } | TrainError::Device { .. })) => {
                // The trainer is back in its last good state: worth keeping, not worth going on
                // with.
                store.save(&mut trainer)?;
                return Err(error.into());
            }
            Err(error) => return Err(error.into()),
        };
        if outcome == Outcome::Finished {
            break;
        }
        if observer.wants_scene() {
            let depth = f64::from(trainer.scale().median_depth);
            observer.scene(&mut || trainer.scene(), depth);
        }
        if !timer.stopped_by_user() && end.is_some_and(|end| Instant::now() >= end) {
            observer.warn(&format!(
                "the time limit ended training after {} of {total} iterations",
                trainer.iteration()
            ));
            break;
        }
        if timer.stopped_by_user() || timer.is_over() {
            store.save(&mut trainer)?;
            if timer.stopped_by_user() {
                return Err(Error::Stopped {
                    stage: STAGE,
                    saved: true,
                });
            }
            timer = CheckpointTimer::new(observer, every_s).at_most(end);
        }
        timer.take_a_step();
    }
    store.finish(&trainer)?;
    Ok(trainer.into_scene())
}

/// Makes the first splats, while a GPU compiles the kernels of the training that follows.
fn first_splats(
    training: &Training<'_>,
    capture: &Capture,
    observer: &dyn Observer,
) -> Result<FirstSplats, InitError> {
    let (init, config) = (
        training.settings.init_config(),
        training.settings.train_config(),
    );
    let layout = SplatLayout {
        isotropic: init.isotropic,
        sh_degree: 0,
        time_degree: 0,
    };
    let max_vram_mb = training.max_vram_mb;
    std::thread::scope(|scope| {
        let warm_up = training
            .gpu
            .as_ref()
            .map(|gpu| scope.spawn(move || gpu.warm_up(capture, layout, &config, max_vram_mb)));
        let first = m4_train::init::initialise(capture, &init, observer);
        // nor does a driver that panics there end the run here
        drop(warm_up.map(ScopedJoinHandle::join));
        first
    })
}

/// Whether a GPU failed that the user did not ask for.
fn may_leave_gpu(training: &Training<'_>, error: &TrainError) -> bool {
    let failed = matches!(error, TrainError::Device { .. });
    failed && training.gpu.as_ref().is_some_and(OpenGpu::is_automatic)
}

/// Trains on the CPU from here on.
fn leave_gpu(
    training: &mut Training<'_>,
    store: &mut dyn TrainStore,
    observer: &dyn Observer,
    error: &TrainError,
) {
    observer.warn(&format!("{error}; the run goes on from there on the CPU"));
    training.gpu = None;
    store.left_gpu();
}

/// Seconds that are left for iterations: of the budget, which the first splats have taken a part
/// of, but at least half of it; and of the time until `end`.
fn affordable(budget_s: f64, started: Instant, end: Option<Instant>) -> f64 {
    let budget_s = if budget_s > 0.0 {
        budget_s
    } else {
        f64::INFINITY
    };
    let left_s = end.map_or(f64::INFINITY, |end| {
        end.saturating_duration_since(Instant::now()).as_secs_f64()
    });
    (budget_s - started.elapsed().as_secs_f64())
        .max(0.5 * budget_s)
        .min(left_s)
}
