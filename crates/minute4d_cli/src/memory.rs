//! Memory that is freed goes back to the system.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How long freed memory may stay with the process.
const PERIOD: Duration = Duration::from_secs(1);

/// When freed memory was given back last.
#[derive(Default)]
pub struct FreedMemory(Mutex<Option<Instant>>);

impl FreedMemory {
    /// Gives back what was freed, at most once a [`PERIOD`].
    ///
    /// The planes of a clip, a few hundred kilobytes each, lie in the heaps of threads, and the GNU allocator keeps the
    /// gaps that they leave: of 96 frames of 480x360 about a fifth of the peak (docs/geometry.md, Memory). With other allocators
    /// this does nothing.
    pub fn give_back(&self) {
        let mut last = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if last.is_none_or(|last| last.elapsed() >= PERIOD) {
            trim();
            *last = Some(Instant::now());
        }
    }
}

#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[expect(unsafe_code, reason = "a C function, which takes a number")]
fn trim() {
    // SAFETY: no pointer is passed, and the function locks the heaps that it looks through.
    unsafe {
        libc::malloc_trim(0);
    }
}

#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn trim() {}
