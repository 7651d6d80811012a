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
    /// The planes of a clip, a few hundred kilobytes each, lie in the heaps of threads, and the GNU
    /// allocator keeps the gaps that they leave: of 96 frames of 480x360 about a fifth of the peak
    /// (docs/geometry-log.md, "Memory"). With other allocators this does nothing.
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

#[cfg(all(test, target_os = "linux", target_env = "gnu"))]
mod tests {
    use super::FreedMemory;

    /// Memory of this process that is in use, by the system's count, bytes.
    fn resident() -> Option<usize> {
        let status = std::fs::read_to_string("/proc/self/status").ok()?;
        let line = status
            .lines()
            .find_map(|line| line.strip_prefix("VmRSS:"))?;
        Some(1024 * line.trim().trim_end_matches(" kB").parse::<usize>().ok()?)
    }

    #[test]
    fn gaps_between_what_is_kept_go_back() {
        const BLOCK: usize = 100_000;
        const COUNT: usize = 600;
        let blocks: Vec<Vec<u8>> = (0..COUNT).map(|_| vec![1; BLOCK]).collect();
        let survivors: Vec<Vec<u8>> = blocks.into_iter().step_by(20).collect();
        let before = resident().unwrap();
        FreedMemory::default().give_back();
        let after = resident().unwrap();
        assert!(before > after + COUNT * BLOCK / 2, "{before} {after}");
        assert_eq!(
            survivors.iter().map(|block| block.len()).sum::<usize>(),
            COUNT / 20 * BLOCK
        );
    }
}
