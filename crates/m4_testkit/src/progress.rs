//! Receivers of progress: one that stops at a given poll, one that keeps warnings.

use m4_core::Progress;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Says stop from a given poll on.
#[derive(Debug)]
pub struct StopAtPoll {
    at: usize,
    asked: AtomicUsize,
}

impl StopAtPoll {
    /// Answers no this many times.
    pub fn after(polls: usize) -> Self {
        Self {
            at: polls,
            asked: AtomicUsize::new(0),
        }
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

/// Keeps warnings.
#[derive(Debug, Default)]
pub struct Heard(Mutex<Vec<String>>);

impl Heard {
    /// The warnings, a line each.
    pub fn all(&self) -> String {
        self.lock().join("\n")
    }

    fn lock(&self) -> MutexGuard<'_, Vec<String>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Progress for Heard {
    fn update(&self, _phase: &str, _done: usize, _total: usize, _note: &str) {}

    fn warn(&self, message: &str) {
        self.lock().push(message.to_owned());
    }

    fn cancelled(&self) -> bool {
        false
    }
}
