//! Runs stages, and observes them.

use crate::Error;
use crate::record::Status;
use m4_core::{Progress, Scene};
use m4_train::MetricsEvent;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// A folder with the record that a stage writes.
pub(crate) trait StageFolder<'a> {
    /// Receives the events of the stage.
    fn observer(&self) -> &'a dyn Observer;

    /// The time from which the stage is asked to stop.
    fn until(&self) -> Option<Instant> {
        None
    }

    /// Records that the stage runs.
    fn begin(&mut self, stage: &'static str) -> Result<(), Error>;

    /// Records how the stage ended.
    fn end(&mut self, stage: &'static str, ended: &Ended) -> Result<(), Error>;
}

/// How a stage ended.
pub(crate) struct Ended {
    /// [`Status::Finished`], [`Status::Stopped`] or [`Status::Failed`].
    pub status: Status,
    /// Wall-clock seconds of this attempt.
    pub seconds: f64,
    /// Warnings of this attempt, each once.
    pub warnings: Vec<String>,
}

/// Runs the work of a stage, and records its start and its end in `folder`. `because` says why an earlier result is not reused. A stop is
/// returned as [`Error::Stopped`].
pub(crate) fn run<'a, F: StageFolder<'a>, R>(
    folder: &mut F,
    stage: &'static str,
    because: Option<&'static str>,
    work: impl FnOnce(&mut F, &RecordingObserver<'_>) -> Result<R, Error>,
) -> Result<R, Error> {
    let observer = folder.observer();
    observer.stage(stage, StageEvent::Started { because });
    let (start, recorder) = (Instant::now(), RecordingObserver::new(observer).until(folder.until()));
    folder.begin(stage)?;
    let outcome = work(folder, &recorder);
    let ended = Ended {
        status: match &outcome {
            Ok(_) => Status::Finished,
            Err(error) if error.is_stop() => Status::Stopped,
            Err(_) => Status::Failed,
        },
        seconds: start.elapsed().as_secs_f64(),
        warnings: recorder.warnings(),
    };
    let recorded = folder.end(stage, &ended);
    let result = outcome.map_err(|error| match error {
        error if error.is_stop() => Error::Stopped { stage, saved: true },
        error => error,
    })?;
    recorded?;
    let seconds = ended.seconds;
    observer.stage(stage, StageEvent::Finished { seconds });
    Ok(result)
}

/// Fails with [`Error::Stopped`] if a stop was requested; `saved` says whether there is something to resume from.
pub(crate) fn check_stop(progress: &dyn Progress, stage: &'static str, saved: bool) -> Result<(), Error> {
    if progress.cancelled() { Err(Error::Stopped { stage, saved }) } else { Ok(()) }
}

/// An event of a stage.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum StageEvent<'a> {
    /// The stage starts; `because` says why an earlier result, if any, could not be reused.
    Started {
        /// The reason, as text.
        because: Option<&'a str>,
    },
    /// The stage continues an interrupted run.
    Resumed {
        /// Steps that were done earlier.
        done: usize,
        /// The total number of steps.
        total: usize,
    },
    /// An earlier result was reused.
    Reused,
    /// The stage has finished.
    Finished {
        /// Wall-clock seconds.
        seconds: f64,
    },
}

/// A [`Progress`] that also follows stages.
pub trait Observer: Progress {
    /// Reports an event of the stage `name`.
    fn stage(&self, name: &str, event: StageEvent<'_>);

    /// Reports the progress of training over this many iterations.
    fn metrics(&self, metrics: &MetricsEvent, iterations: usize) {
        let _ = (metrics, iterations);
    }

    /// Returns true if [`scene`](Self::scene) should be called; training asks between two steps, so the answer
    /// must be cheap.
    fn wants_scene(&self) -> bool {
        false
    }

    /// Offers the current scene: `copy` makes a copy, which training waits for.
    /// `median_depth` is that of the capture, world units.
    fn scene(&self, copy: &mut dyn FnMut() -> Scene, median_depth: f64) {
        let _ = (copy, median_depth);
    }
}

impl Observer for m4_core::Silent {
    fn stage(&self, _name: &str, _event: StageEvent<'_>) {}
}

/// Forwards everything to another observer, and keeps the warnings for the record.
pub struct RecordingObserver<'a> {
    observer: &'a dyn Observer,
    warnings: Mutex<Vec<String>>,
    until: Option<Instant>,
}

impl<'a> RecordingObserver<'a> {
    /// Creates one that forwards to `observer`.
    #[must_use]
    pub fn new(observer: &'a dyn Observer) -> Self {
        Self { observer, warnings: Mutex::new(Vec::new()), until: None }
    }

    /// Like [`new`](Self::new), but asks to stop after `end`.
    #[must_use]
    pub fn until(self, end: Option<Instant>) -> Self {
        Self { until: end, ..self }
    }

    /// Returns every warning so far, each once, in the order of first appearance.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        self.warnings.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Progress for RecordingObserver<'_> {
    fn update(&self, phase: &str, done: usize, total: usize, note: &str) {
        self.observer.update(phase, done, total, note);
    }

    fn warn(&self, message: &str) {
        let mut warnings = self.warnings.lock().unwrap_or_else(PoisonError::into_inner);
        if warnings.iter().any(|w| w == message) {
            return;
        }
        warnings.push(message.to_owned());
        drop(warnings);
        self.observer.warn(message);
    }

    fn cancelled(&self) -> bool {
        self.observer.cancelled() || self.until.is_some_and(|end| Instant::now() >= end)
    }
}

impl Observer for RecordingObserver<'_> {
    fn stage(&self, name: &str, event: StageEvent<'_>) {
        self.observer.stage(name, event);
    }
}

#[cfg(test)]
mod tests {
    use super::RecordingObserver;
    use m4_core::{Progress, Silent};

    #[test]
    fn repeated_warnings_are_recorded_once() {
        let keeper = RecordingObserver::new(&Silent);
        for message in ["dark", "blurred", "dark"] {
            keeper.warn(message);
        }
        assert_eq!(keeper.warnings(), ["dark", "blurred"]);
    }
}
