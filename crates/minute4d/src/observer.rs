//! Progress of stages, and warnings.

use crate::Error;
use m4_core::{Progress, Scene};
use m4_train::MetricsEvent;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Fails with [`Error::Stopped`] if a stop was requested; `saved` says whether there is something
/// to resume from.
pub fn check_stop(progress: &dyn Progress, stage: &'static str, saved: bool) -> Result<(), Error> {
    if progress.cancelled() {
        Err(Error::Stopped { stage, saved })
    } else {
        Ok(())
    }
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
    fn stage(&self, name: &str, event: StageEvent<'_>) {
        let _ = (name, event);
    }

    /// Reports the progress of training over this many iterations.
    fn metrics(&self, metrics: &MetricsEvent, iterations: usize) {
        let _ = (metrics, iterations);
    }

    /// Returns true if [`scene`](Self::scene) should be called; training asks between two steps, so
    /// the answer must be cheap.
    fn wants_scene(&self) -> bool {
        false
    }

    /// Offers the current scene: `copy` makes a copy, which training waits for.
    /// `median_depth` is that of the capture, world units.
    fn scene(&self, copy: &mut dyn FnMut() -> Scene, median_depth: f64) {
        let _ = (copy, median_depth);
    }
}

impl Observer for m4_core::Silent {}

/// A [`Recording`] of an observer.
pub type RecordingObserver<'a> = Recording<'a, dyn Observer + 'a>;

/// Forwards everything to an observer or another [`Progress`], and keeps the warnings for the
/// record, or until they are released.
pub struct Recording<'a, P: ?Sized> {
    observer: &'a P,
    warnings: Mutex<Vec<String>>,
    /// Whether warnings are passed on at once.
    warns: bool,
    until: Option<Instant>,
}

impl<'a, P: Progress + ?Sized> Recording<'a, P> {
    /// Creates one that forwards to `observer`.
    #[must_use]
    pub fn new(observer: &'a P) -> Self {
        Self {
            observer,
            warnings: Mutex::new(Vec::new()),
            warns: true,
            until: None,
        }
    }

    /// Creates one that keeps warnings back.
    pub(crate) fn holding(observer: &'a P) -> Self {
        Self {
            warns: false,
            ..Self::new(observer)
        }
    }

    /// Passes on the warnings that were kept back.
    pub(crate) fn release(self) {
        let warnings = self.warnings();
        warnings.iter().for_each(|w| self.observer.warn(w));
    }

    /// Like [`new`](Self::new), but asks to stop after `end`.
    #[must_use]
    pub fn until(self, end: Option<Instant>) -> Self {
        Self { until: end, ..self }
    }

    /// Returns every warning so far, each once, in the order of first appearance.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        self.warnings
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }
}

impl<P: Progress + ?Sized> Progress for Recording<'_, P> {
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
        if self.warns {
            self.observer.warn(message);
        }
    }

    fn cancelled(&self) -> bool {
        self.observer.cancelled() || self.until.is_some_and(|end| Instant::now() >= end)
    }
}

impl<P: Observer + ?Sized> Observer for Recording<'_, P> {
    fn stage(&self, name: &str, event: StageEvent<'_>) {
        self.observer.stage(name, event);
    }

    fn metrics(&self, metrics: &MetricsEvent, iterations: usize) {
        self.observer.metrics(metrics, iterations);
    }

    fn wants_scene(&self) -> bool {
        self.observer.wants_scene()
    }

    fn scene(&self, copy: &mut dyn FnMut() -> Scene, median_depth: f64) {
        self.observer.scene(copy, median_depth);
    }
}

#[cfg(test)]
mod tests {
    use super::Recording;
    use m4_core::{Progress, Silent};

    #[test]
    fn repeated_warnings_are_recorded_once() {
        let keeper = Recording::new(&Silent);
        for message in ["dark", "blurred", "dark"] {
            keeper.warn(message);
        }
        assert_eq!(keeper.warnings(), ["dark", "blurred"]);
    }
}
