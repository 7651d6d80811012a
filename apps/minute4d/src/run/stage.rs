//! Runs a stage, and records how it ended.

use super::record::Status;
use minute4d::observer::{Observer, RecordingObserver, StageEvent};
use minute4d::{Error, hash};
use std::time::Instant;

/// A folder with the record that a stage writes.
pub(crate) trait StageFolder<'a> {
    /// Receives the events of the stage.
    fn observer(&self) -> &'a dyn Observer;

    /// The time from which the stage is asked to stop.
    fn until(&self) -> Option<Instant> {
        None
    }

    /// Records that the stage runs.
    fn begin(&mut self, stage: &'static str) -> Result<(), Error>;

    /// Records how the stage ended.
    fn end(&mut self, stage: &'static str, ended: &Ended) -> Result<(), Error>;
}

/// How a stage ended.
pub(crate) struct Ended {
    /// [`Status::Finished`], [`Status::Stopped`] or [`Status::Failed`].
    pub status: Status,
    /// Wall-clock seconds of this attempt.
    pub seconds: f64,
    /// Warnings of this attempt, each once.
    pub warnings: Vec<String>,
}

/// The key of a stage: the hash of its name, of this release, and of all that its result depends
/// on.
pub(crate) fn key(stage: &str, parts: &[&str]) -> String {
    hash::of_parts(&[&[stage, env!("CARGO_PKG_VERSION")], parts].concat())
}

/// Runs the work of a stage, and records its start and its end in `folder`. `because` says why an
/// earlier result is not reused. A stop is returned as [`Error::Stopped`].
pub(crate) fn run<'a, F: StageFolder<'a>, R>(
    folder: &mut F,
    stage: &'static str,
    because: Option<&'static str>,
    work: impl FnOnce(&mut F, &RecordingObserver<'_>) -> Result<R, Error>,
) -> Result<R, Error> {
    let observer = folder.observer();
    observer.stage(stage, StageEvent::Started { because });
    let (start, recorder) = (
        Instant::now(),
        RecordingObserver::new(observer).until(folder.until()),
    );
    folder.begin(stage)?;
    let outcome = work(folder, &recorder);
    let ended = Ended {
        status: match &outcome {
            Ok(_) => Status::Finished,
            Err(error) if error.is_stop() => Status::Stopped,
            Err(_) => Status::Failed,
        },
        seconds: start.elapsed().as_secs_f64(),
        warnings: recorder.warnings(),
    };
    let recorded = folder.end(stage, &ended);
    let result = outcome.map_err(|error| match error {
        error if error.is_stop() => Error::Stopped { stage, saved: true },
        error => error,
    })?;
    recorded?;
    let seconds = ended.seconds;
    observer.stage(stage, StageEvent::Finished { seconds });
    Ok(result)
}
