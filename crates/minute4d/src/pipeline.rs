//! The whole pipeline, and the job that every stage gets.

use crate::clock::Clock;
use crate::device::DeviceRequest;
use crate::folder::{CAPTURE_FOLDER, Existing};
use crate::geometry::GeometryOptions;
use crate::record::{Input, RunRecord, StageRecord};
use crate::stage::RecordingObserver;
use crate::workspace::Workspace;
use crate::{Error, Observer, Settings, geometry, hash, train};
use m4_kernels::SimdLevel;
use std::path::Path;

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
    let source = Input { path: input.display().to_string(), blake3: hash::of_path(input)? };
    Workspace::open(out, source, job, clock)?.finish(|run| {
        let folder = run.path(CAPTURE_FOLDER);
        let keeper = RecordingObserver::new(job.observer).until(clock.end());
        let stage_job = Job {
            settings: job.settings.clone(),
            // The folder of the run was taken over; so is the capture in it.
            // geometry runs on the CPU
            device: DeviceRequest::default(),
            existing: Existing::Resume,
            observer: &keeper,
        };
        let made = geometry::make(input, &folder, &stage_job)
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
        train::all(run, &capture)
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
#[must_use]
pub fn threads() -> usize {
    rayon::current_num_threads()
}
