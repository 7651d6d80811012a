//! Interrupts work.

use m4_core::Progress;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Says stop from a given poll on.
#[derive(Debug)]
pub struct StopAtPoll {
    at: usize,
    asked: AtomicUsize,
}

impl StopAtPoll {
    /// Answers no this many times.
    #[must_use]
    pub fn after(polls: usize) -> Self {
        Self { at: polls, asked: AtomicUsize::new(0) }
    }

    /// Number of polls.
    pub fn asked(&self) -> usize {
        self.asked.load(Ordering::Relaxed)
    }
}

impl Progress for StopAtPoll {
    fn update(&self, _phase: &str, _done: usize, _total: usize, _note: &str) {}

    fn warn(&self, _message: &str) {}

    fn cancelled(&self) -> bool {
        self.asked.fetch_add(1, Ordering::Relaxed) >= self.at
    }
}
