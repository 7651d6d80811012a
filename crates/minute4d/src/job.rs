//! The job that every stage gets.

use crate::device::DeviceRequest;
use crate::folder::Existing;
use crate::{Error, Observer, Settings};
use m4_kernels::SimdLevel;

/// The inputs of every stage: settings, device, the treatment of earlier results, and the observer.
pub struct Job<'a> {
    /// Every setting.
    pub settings: Settings,
    /// The device for training.
    pub device: DeviceRequest,
    /// What to do with a folder that is not empty.
    pub existing: Existing,
    /// Receives progress, and may ask to stop.
    pub observer: &'a dyn Observer,
}

impl Job<'_> {
    /// Refuses settings that no stage can use, before any of them starts.
    pub(crate) fn check(&self) -> Result<SimdLevel, Error> {
        self.settings.check()?;
        Ok(SimdLevel::detect()?)
    }
}

/// Calls `f` on a pool of this many threads; on all cores for `None`.
///
/// # Errors
///
/// [`Error::Internal`] if the system gives no threads.
pub fn with_threads<R: Send>(threads: Option<usize>, f: impl FnOnce() -> R + Send) -> Result<R, Error> {
    let Some(threads) = threads else { return Ok(f()) };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| Error::Internal {
            what: format!("cannot start {threads} threads: {e}"),
        })?;
    Ok(pool.install(f))
}

/// Threads of the current pool.
#[must_use]
pub fn threads() -> usize {
    rayon::current_num_threads()
}
