//! Images are decoded in parallel; those that take much more memory than their files wait for one
//! another, so that all together stay within [`FREE_BYTES`] and their share by the size of their
//! files.

use crate::files::FREE_BYTES;
use std::sync::{Condvar, Mutex, PoisonError};

/// Bytes that are taken.
static TAKEN: Mutex<u64> = Mutex::new(0);
static GIVEN_BACK: Condvar = Condvar::new();

/// A share of [`FREE_BYTES`], given back when it is dropped. While one is held nothing else may be
/// waited for.
pub(super) struct Share(u64);

impl Share {
    /// Waits until there is room.
    pub(super) fn take(bytes: u64) -> Self {
        let lock = TAKEN.lock().unwrap_or_else(PoisonError::into_inner);
        let full = |in_use: &mut u64| *in_use > 0 && *in_use + bytes > FREE_BYTES;
        let mut in_use = GIVEN_BACK
            .wait_while(lock, full)
            .unwrap_or_else(PoisonError::into_inner);
        *in_use += bytes;
        Self(bytes)
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        *TAKEN.lock().unwrap_or_else(PoisonError::into_inner) -= self.0;
        GIVEN_BACK.notify_all();
    }
}
