//! The whole pipeline, the job that every stage gets, and the time limit of a run.

use crate::device::DeviceRequest;
use crate::folder::{CAPTURE_FOLDER, Existing};
use crate::geometry::GeometryOptions;
use crate::hash::{self, HashedCapture};
use crate::record::{Input, RunRecord, StageRecord};
use crate::stage::RecordingObserver;
use crate::workspace::Workspace;
use crate::{Error, Observer, Settings, geometry, train};
use m4_kernels::SimdLevel;
use std::path::Path;
use std::time::{Duration, Instant};

/// Turns a video, a folder of images, or a capture into a scene; finished stages of an earlier run are reused
/// with [`Existing::Resume`].
///
/// # Errors
///
/// [`Error`] of the stage that failed; finished work stays in `out`.
pub fn run(input: &Path, out: &Path, job: &Job<'_>) -> Result<RunRecord, Error> {
    if is_capture(input) {
        if job.settings.geometry != GeometryOptions::default() {
            job.observer.warn(
                "the input is a capture, whose geometry is used unchanged: --frontend, --segmenter, --intrinsics, --poses, --masks and \
                 --depth have no effect",
            );
        }
        return train::make(input, out, job);
    }
    if !input.exists() {
        return Err(Error::Missing { what: "video, folder of images or capture", path: input.to_path_buf() });
    }
    job.check()?;
    let clock = Clock::start(&job.settings);
    let source = Input { path: input.display().to_string(), blake3: hash::of_input(input, Some(out), job.observer)? };
    Workspace::open(out, input, source.clone(), job, clock)?.finish(|run| {
        let folder = run.path(CAPTURE_FOLDER);
        let recorder = RecordingObserver::new(job.observer).until(clock.end());
        let made = geometry::of_source(input, source, &folder, &job.of_geometry(&recorder))
            .map_err(|error| clock.blame(error, geometry::STAGE, job.observer.cancelled()))?;
        let stage = StageRecord {
            key: made.key,
            done: true,
            seconds: made.seconds,
            peak_memory_bytes: made.peak_memory_bytes,
            warnings: made.warnings,
        };
        run.record.stages.insert(geometry::STAGE.to_owned(), stage);
        let capture = train::read(&folder, &job.settings, job.observer)?;
        train::all(run, &HashedCapture::new(capture))
    })
}

/// True for a folder with a list of posed frames, or such a list itself.
#[must_use]
pub fn is_capture(path: &Path) -> bool {
    let listed = ["transforms_train.json", "transforms.json"];
    listed.iter().any(|name| path.join(name).is_file()) || path.extension().is_some_and(|e| e == "json")
}

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
    /// The job of the geometry stage of a run: the same settings and device, which its networks use too.
    fn of_geometry<'a>(&self, observer: &'a dyn Observer) -> Job<'a> {
        Job { settings: self.settings.clone(), device: self.device, existing: Existing::Resume, observer }
    }

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
        .map_err(|e| Error::Internal { what: format!("cannot start {threads} threads: {e}") })?;
    Ok(pool.install(f))
}

/// Threads of the current pool.
pub fn threads() -> usize {
    rayon::current_num_threads()
}

/// Reserve for reading back, page and preview: share of the time left when training starts, and its maximum in seconds.
const RESERVE: f64 = 0.25;
const MOST_RESERVE_S: f64 = 120.0;

/// The start and the time limit of a run.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Clock {
    started: Instant,
    limit: Option<Duration>,
}

impl Clock {
    /// Starts now.
    pub fn start(settings: &Settings) -> Self {
        let seconds = settings.limit.time_s;
        let limit = Duration::try_from_secs_f64(seconds).ok().filter(|_| seconds > 0.0);
        Self { started: Instant::now(), limit }
    }

    /// Returns the end of the time limit.
    pub fn end(&self) -> Option<Instant> {
        self.started.checked_add(self.limit?)
    }

    /// Returns true after the limit is reached.
    pub fn is_over(&self) -> bool {
        self.end().is_some_and(|end| Instant::now() >= end)
    }

    /// Returns the time by which training that starts now must end.
    pub fn end_of_training(&self) -> Option<Instant> {
        let left_s = self.end()?.saturating_duration_since(Instant::now()).as_secs_f64();
        let reserve_s = (RESERVE * left_s).min(MOST_RESERVE_S);
        Some(Instant::now() + Duration::from_secs_f64(left_s - reserve_s))
    }

    /// Returns the same failure, or "time is up" if only the clock asked to stop.
    pub fn blame(&self, error: Error, stage: &'static str, asked_to_stop: bool) -> Error {
        match self.limit {
            Some(limit) if error.is_stop() && !asked_to_stop && self.is_over() => {
                Error::TimeLimit { stage, seconds: limit.as_secs_f64() }
            }
            _ => error,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Clock, Job};
    use crate::device::DeviceChoice;
    use crate::{Category, Error, Existing, Settings, Silent};

    #[test]
    fn networks_of_a_run_use_the_device_that_was_asked_for() {
        let device = DeviceChoice::Gpu(Some(1)).into();
        let job = Job { settings: Settings::fast(), device, existing: Existing::Refuse, observer: &Silent };
        let of_geometry = job.of_geometry(&Silent);
        assert_eq!((of_geometry.device, of_geometry.existing), (device, Existing::Resume));
    }

    fn clock(time_s: f64) -> Clock {
        let mut settings = Settings::fast();
        settings.limit.time_s = time_s;
        Clock::start(&settings)
    }

    #[test]
    fn no_limit_never_expires() {
        for none in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let clock = clock(none);
            assert!(clock.end().is_none() && clock.end_of_training().is_none() && !clock.is_over());
        }
    }

    #[test]
    fn training_leaves_time_for_the_rest() {
        let clock = clock(1000.0);
        let (end, training) = (clock.end().unwrap(), clock.end_of_training().unwrap());
        let reserve_s = (end - training).as_secs_f64();
        assert!((119.0..=121.0).contains(&reserve_s), "{reserve_s}");
    }

    #[test]
    fn stop_without_a_request_is_the_time_limit() {
        let stop = || Error::Stopped { stage: "geometry", saved: true };
        let over = clock(1e-9);
        assert_eq!(over.blame(stop(), "geometry", false).category(), Category::TryAgain);
        assert_eq!(over.blame(stop(), "geometry", true).category(), Category::Stopped);
        assert_eq!(clock(1000.0).blame(stop(), "geometry", false).category(), Category::Stopped);
    }
}
