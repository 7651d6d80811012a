//! The whole pipeline in the folder of a run: stages, their records, checkpoints and results, each
//! on disk.

mod checkpoint;
mod clock;
pub mod enhance;
pub mod folder;
pub mod geometry;
pub mod import;
pub mod preview;
pub mod record;
mod stage;
mod steps;
pub mod train;
pub mod viewer;
mod workspace;

use clock::Clock;
use m4_kernels::SimdLevel;
use minute4d::device::DeviceRequest;
use minute4d::hash::HashedCapture;
use minute4d::layout::{CAPTURE_FOLDER, Existing};
use minute4d::observer::RecordingObserver;
use minute4d::{Error, Observer, Settings};
use record::{RunRecord, Source, StageRecord};
use std::path::Path;
use workspace::Workspace;

/// Turns a video or a folder of images into a scene; finished stages of an earlier run are reused
/// with [`Existing::Resume`]. A `poster` is for overviews of many clips.
///
/// # Errors
///
/// [`Error`] of the stage that failed; finished work stays in `out`.
pub fn run(input: &Path, out: &Path, job: &Job<'_>, poster: bool) -> Result<RunRecord, Error> {
    Error::unless_exists("video, folder of images or capture", input)?;
    job.check()?;
    let clock = Clock::start(&job.settings);
    let source = Source::read(input, Some(out), job.observer)?;
    Workspace::open(out, &source, job, clock)?.finish(|run| {
        let folder = run.path(CAPTURE_FOLDER);
        let recorder = RecordingObserver::new(job.observer).until(clock.end());
        let (record, capture) = geometry::of_source(&source, &folder, &job.of_geometry(&recorder))
            .map_err(|error| clock.blame(error, geometry::STAGE, job.observer.cancelled()))?;
        let stage = StageRecord {
            key: record.key,
            done: true,
            seconds: record.seconds,
            peak_memory_bytes: record.peak_memory_bytes,
            warnings: record.warnings,
        };
        run.record.stages.insert(geometry::STAGE.to_owned(), stage);
        let options = &job.settings.capture;
        let capture = match capture {
            Some(capture) => m4_io::capture::as_read(&folder, capture, options, job.observer)?,
            None => train::read(&folder, &job.settings, job.observer)?,
        };
        train::all(run, &HashedCapture::new(capture), poster)
    })
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

impl<'j> Job<'j> {
    /// Puts a job together.
    pub fn new(
        settings: Settings,
        device: impl Into<DeviceRequest>,
        existing: Existing,
        observer: &'j dyn Observer,
    ) -> Self {
        Self {
            settings,
            device: device.into(),
            existing,
            observer,
        }
    }

    /// The job of the geometry stage of a run: the same settings and device, which its networks use
    /// too.
    fn of_geometry<'a>(&self, observer: &'a dyn Observer) -> Job<'a> {
        Job::new(
            self.settings.clone(),
            self.device,
            Existing::Resume,
            observer,
        )
    }

    /// Refuses settings that no stage can use, before any of them starts.
    pub fn check(&self) -> Result<SimdLevel, Error> {
        self.settings.check()?;
        Ok(SimdLevel::detect()?)
    }
}

/// Calls `f` on a pool of this many threads; on all cores for `None`.
///
/// # Errors
///
/// [`Error::Internal`] if the system gives no threads.
pub fn with_threads<R: Send>(
    threads: Option<usize>,
    f: impl FnOnce() -> R + Send,
) -> Result<R, Error> {
    let Some(threads) = threads else {
        return Ok(f());
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| Error::internal(format!("cannot start {threads} threads: {e}")))?;
    Ok(pool.install(f))
}

/// Threads of the current pool.
pub fn threads() -> usize {
    rayon::current_num_threads()
}

#[cfg(test)]
mod tests {
    use super::{Existing, Job};
    use minute4d::device::DeviceChoice;
    use minute4d::{Settings, Silent};

    #[test]
    fn networks_of_a_run_use_the_device_that_was_asked_for() {
        let device = DeviceChoice::Gpu(Some(1)).into();
        let job = Job::new(Settings::fast(), device, Existing::Refuse, &Silent);
        let of_geometry = job.of_geometry(&Silent);
        assert_eq!(
            (of_geometry.device, of_geometry.existing),
            (device, Existing::Resume)
        );
    }
}
