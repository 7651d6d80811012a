//! Interrupts and resumes work.

use m4_core::{Cache, Progress};
use std::collections::HashMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// A cache in memory.
#[derive(Debug, Default)]
pub struct MemoryCache(Mutex<HashMap<String, Vec<u8>>>);

impl MemoryCache {
    fn all(&self) -> MutexGuard<'_, HashMap<String, Vec<u8>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Removes what has this name.
    pub fn remove(&self, name: &str) {
        self.all().remove(name);
    }
}

impl Cache for MemoryCache {
    fn get(&self, name: &str) -> Option<Vec<u8>> {
        self.all().get(name).cloned()
    }

    fn put(&self, name: &str, bytes: &[u8]) {
        self.all().insert(name.to_owned(), bytes.to_vec());
    }
}

/// Says stop from the so-manieth time on that it is asked.
#[derive(Debug)]
pub struct StopAtPoll {
    at: usize,
    asked: AtomicUsize,
}

impl StopAtPoll {
    /// Answers no this many times.
    #[must_use]
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
