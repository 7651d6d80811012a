//! How much memory reading takes. The allocator counts for the whole process.

use peak_alloc::PeakAlloc;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::{Mutex, MutexGuard, PoisonError};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

static TURN: Mutex<()> = Mutex::new(());

/// Holds the other tests of this program back, whose memory would be counted too.
pub fn alone() -> MutexGuard<'static, ()> {
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What `work` gives, none where it panics (in silence: the caller says of what), and the bytes that it took at most.
pub fn measured<T>(work: impl FnOnce() -> T) -> (Option<T>, usize) {
    let loud = take_hook();
    set_hook(Box::new(|_| {}));
    let before = MEMORY.current_usage();
    MEMORY.reset_peak_usage();
    let outcome = catch_unwind(AssertUnwindSafe(work)).ok();
    let taken = MEMORY.peak_usage().saturating_sub(before);
    set_hook(loud);
    (outcome, taken)
}
