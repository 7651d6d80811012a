//! Interrupts training for checkpoints.

use crate::Observer;
use m4_core::Progress;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Stops a trainer when it is time for a checkpoint, when a page requests the scene, or on request
/// of the user.
pub(super) struct CheckpointTimer<'a> {
    observer: &'a dyn Observer,
    until: Instant,
    /// Training asks before every step; the first step is always taken, however short the wait.
    asked: AtomicBool,
}

impl<'a> CheckpointTimer<'a> {
    /// Lasts for this many seconds.
    pub fn new(observer: &'a dyn Observer, seconds: f64) -> Self {
        const LONGEST: Duration = Duration::from_secs(1 << 31);
        let wait = Duration::try_from_secs_f64(seconds)
            .unwrap_or(LONGEST)
            .min(LONGEST);
        Self {
            observer,
            until: Instant::now() + wait,
            asked: AtomicBool::new(false),
        }
    }

    /// The same, but not beyond `end`.
    pub fn at_most(self, end: Option<Instant>) -> Self {
        let until = end.map_or(self.until, |end| end.min(self.until));
        Self { until, ..self }
    }

    /// True when it is time for a checkpoint.
    pub fn is_over(&self) -> bool {
        Instant::now() >= self.until
    }

    /// Allows the trainer another step, whatever the time is.
    pub fn take_a_step(&self) {
        self.asked.store(false, Ordering::Relaxed);
    }

    /// True if the user asked to stop.
    pub fn stopped_by_user(&self) -> bool {
        self.observer.cancelled()
    }
}

impl Progress for CheckpointTimer<'_> {
    fn update(&self, phase: &str, done: usize, total: usize, note: &str) {
        self.observer.update(phase, done, total, note);
    }

    fn warn(&self, message: &str) {
        self.observer.warn(message);
    }

    fn cancelled(&self) -> bool {
        let due = || self.is_over() || self.observer.wants_scene();
        self.observer.cancelled() || (self.asked.swap(true, Ordering::Relaxed) && due())
    }
}

#[cfg(test)]
mod tests {
    use super::CheckpointTimer;
    use m4_core::{Progress, Silent};

    #[test]
    fn at_least_one_step_is_allowed_per_interval() {
        let timer = CheckpointTimer::new(&Silent, 0.0);
        assert!(!timer.cancelled());
        assert!(timer.cancelled() && !timer.stopped_by_user() && timer.is_over());
        timer.take_a_step();
        assert!(!timer.cancelled(), "one more");
        let endless = CheckpointTimer::new(&Silent, f64::INFINITY);
        assert!(!endless.cancelled() && !endless.cancelled());
    }
}
