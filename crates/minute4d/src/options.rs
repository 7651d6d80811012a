//! Options of the library's functions: settings, device, progress, cancellation.

use crate::Settings;
use crate::device::DeviceChoice;
use crate::observer::Observer;
use m4_core::Progress;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A report of long work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Event<'a> {
    /// `done` of `total` steps of a phase are finished; `note` is a short figure for people, and
    /// may be empty.
    Progress {
        /// The phase.
        phase: &'a str,
        /// Finished steps.
        done: usize,
        /// All steps.
        total: usize,
        /// A figure, such as the loss.
        note: &'a str,
    },
    /// Something about the input or the result that the user should know.
    Warning(&'a str),
}

/// What receives reports, from any thread.
type Report<'a> = dyn Fn(Event<'_>) + Send + Sync + 'a;

/// Options of [`reconstruct`](crate::reconstruct()) and [`train`](crate::train()).
///
/// ```
/// use minute4d::Options;
/// let options = Options::new().iterations(500).seed(7).on_event(|event| println!("{event:?}"));
/// assert_eq!(options.settings().train.iterations, 500);
/// ```
#[derive(Clone, Default)]
pub struct Options<'a> {
    settings: Settings,
    device: DeviceChoice,
    on_event: Option<Arc<Report<'a>>>,
    cancel: Option<Arc<AtomicBool>>,
}

impl<'a> Options<'a> {
    /// The default settings, on the best discrete GPU or else the CPU, without reports.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Uses these settings.
    #[must_use]
    pub fn with_settings(mut self, settings: Settings) -> Self {
        self.settings = settings;
        self
    }

    /// Trains for this many iterations, whatever time they take.
    #[must_use]
    pub fn iterations(mut self, iterations: usize) -> Self {
        (self.settings.train.iterations, self.settings.train.budget_s) = (iterations, 0.0);
        self
    }

    /// Trains for about this many seconds.
    #[must_use]
    pub fn seconds(mut self, seconds: f64) -> Self {
        self.settings.train.budget_s = seconds;
        self
    }

    /// Uses one seed for every random number. The same seed, input and settings give the same bits
    /// on the CPU.
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.settings.set_seed(seed);
        self
    }

    /// Keeps at most this many frames of a video, evenly spaced.
    #[must_use]
    pub fn max_frames(mut self, frames: usize) -> Self {
        self.settings.video.max_frames = Some(frames);
        self
    }

    /// Computes on this device.
    #[must_use]
    pub fn device(mut self, device: DeviceChoice) -> Self {
        self.device = device;
        self
    }

    /// Calls `report` with progress and warnings, from any thread.
    #[must_use]
    pub fn on_event(mut self, report: impl Fn(Event<'_>) + Send + Sync + 'a) -> Self {
        self.on_event = Some(Arc::new(report));
        self
    }

    /// Stops with [`Error::Stopped`](crate::Error::Stopped) soon after `cancel` becomes true.
    #[must_use]
    pub fn cancel_with(mut self, cancel: Arc<AtomicBool>) -> Self {
        self.cancel = Some(cancel);
        self
    }

    /// The settings.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    pub(crate) fn device_choice(&self) -> DeviceChoice {
        self.device
    }
}

impl fmt::Debug for Options<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Options")
            .field("settings", &self.settings)
            .field("device", &self.device)
            .finish_non_exhaustive()
    }
}

impl Progress for Options<'_> {
    fn update(&self, phase: &str, done: usize, total: usize, note: &str) {
        if let Some(report) = &self.on_event {
            report(Event::Progress {
                phase,
                done,
                total,
                note,
            });
        }
    }

    fn warn(&self, message: &str) {
        if let Some(report) = &self.on_event {
            report(Event::Warning(message));
        }
    }

    fn cancelled(&self) -> bool {
        self.cancel
            .as_ref()
            .is_some_and(|cancel| cancel.load(Ordering::Relaxed))
    }
}

impl Observer for Options<'_> {}

#[cfg(test)]
mod tests {
    use super::{Event, Options};
    use m4_core::Progress;
    use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
    use std::sync::{Arc, Mutex};

    #[test]
    fn reports_reach_the_closure_and_a_flag_cancels() {
        let (steps, warnings) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
        let cancel = Arc::new(AtomicBool::new(false));
        let options =
            Options::new()
                .cancel_with(Arc::clone(&cancel))
                .on_event(|event| match event {
                    Event::Progress { done, .. } => steps.store(done, Ordering::Relaxed),
                    Event::Warning(message) => warnings.lock().unwrap().push(message.to_owned()),
                });
        options.update("train", 3, 5, "");
        options.warn("dark");
        assert!(!options.cancelled());
        cancel.store(true, Ordering::Relaxed);
        assert!(options.cancelled());
        assert_eq!(
            (
                steps.load(Ordering::Relaxed),
                warnings.lock().unwrap().as_slice()
            ),
            (3, &["dark".to_owned()][..])
        );
    }
}
