//! The second stage: trains a scene from a capture.

mod checkpoint;

use crate::device::OpenGpu;
use crate::error::OutputError;
use crate::folder::{self, METRICS_FILE, SCENE_FILE, VIEWER_FILE};
use crate::hash::{self, HashedCapture};
use crate::pipeline::Clock;
use crate::record::{Device, Input, RunRecord, SplatCount};
use crate::settings::{InitSettings, Profile, TrainSettings, part_to_toml};
use crate::stage::{RecordingObserver, check_stop};
use crate::workspace::{Task, Workspace};
use crate::{Error, Job, Observer, Settings, StageEvent, preview, viewer};
use checkpoint::{CheckpointTimer, Checkpoints, MetricsLog};
use m4_core::{Capture, Progress, Scene, SplatLayout, Splats};
use m4_io::capture::Split;
use m4_io::scene::safetensors;
use m4_train::init::{FirstSplats, InitError};
use m4_train::{BackendError, BackendMaker, MetricsEvent, Outcome, TrainError, Trainer};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::thread::ScopedJoinHandle;
use std::time::Instant;

/// Name of the stage.
pub const STAGE: &str = "train";

/// The settings that this stage depends on.
#[derive(Serialize)]
struct Part<'a> {
    profile: Profile,
    init: &'a InitSettings,
    train: &'a TrainSettings,
}

/// Trains a scene on a capture and makes the preview, or resumes a stopped run.
///
/// # Errors
///
/// [`Error`]: the capture cannot be used, the folder cannot be used, or the user asked to stop.
pub fn make(capture: &Path, out: &Path, job: &Job<'_>) -> Result<RunRecord, Error> {
    if !capture.exists() {
        return Err(Error::Missing { what: "capture", path: capture.to_path_buf() });
    }
    job.check()?;
    let clock = Clock::start(&job.settings);
    // Read before the folder is made, so that a wrong path leaves nothing behind.
    let data = read(capture, &job.settings, job.observer)?;
    let data = HashedCapture::new(data);
    let input = Input { path: capture.display().to_string(), blake3: data.hash.clone() };
    Workspace::open(out, capture, input, job, clock)?.finish(|run| all(run, &data))
}

/// Trains; writes preview and viewer if time remains.
pub(crate) fn all(run: &mut Workspace<'_>, capture: &HashedCapture) -> Result<(), Error> {
    let (scene, packed) = stage(run, capture)?;
    let plan = viewer::plan(run, capture)?;
    let wanted = matches!(plan, viewer::Plan::Write { .. }) && !run.clock.is_over();
    // The page is made while the preview is drawn; a scene of an earlier run is packed now.
    let packed = if wanted { packed.or_else(|| viewer::packed(run, &scene)) } else { None };
    let (preview, page) = rayon::join(
        || run.if_there_is_time("a preview", |run| preview::stage(run, capture, &scene)),
        || packed.map(|packed| viewer::Page::new(packed, &capture.capture, &scene)).transpose(),
    );
    preview?;
    run.if_there_is_time("the page", |run| viewer::stage(run, plan, page?))
}

/// Reads the training frames of a capture.
pub(crate) fn read(capture: &Path, settings: &Settings, observer: &dyn Observer) -> Result<Capture, Error> {
    Ok(m4_io::capture::read(capture, Split::Train, &settings.capture, observer)?)
}

/// Trains within a run, unless that was done before. Returns the scene, and the splats for its page where they were packed as well.
pub(crate) fn stage(
    run: &mut Workspace<'_>,
    capture: &HashedCapture,
) -> Result<(Scene, Option<viewer::Packed>), Error> {
    let settings = &run.job.settings;
    let part = part_to_toml(&Part { profile: settings.profile, init: &settings.init, train: &settings.train })?;
    let mut parts = vec![STAGE, env!("CARGO_PKG_VERSION"), &capture.hash, run.level.name(), &part];
    // last digits are the device's own
    parts.extend(run.gpu.as_ref().map(OpenGpu::name));
    let key = hash::of_parts(&parts);
    let files = [SCENE_FILE, METRICS_FILE];
    let task = run.task(STAGE, &key, &files)?;
    let (because, seconds) = match task {
        Task::Reuse => {
            run.job.observer.stage(STAGE, StageEvent::Reused);
            return Ok((safetensors::read(&run.path(SCENE_FILE))?.scene, None));
        }
        Task::Work { because, seconds_before } => (because, seconds_before),
    };
    let same_key = key.clone();
    let made = run
        .stage(STAGE, key, (because, seconds), &files, |run, keeper| train(run, &capture.capture, &same_key, keeper))?;
    // Only now: until the record says that the scene is whole, they are what a killed run continues from.
    folder::remove_checkpoints(&run.folder)?;
    Ok(made)
}

fn train(
    run: &mut Workspace<'_>,
    capture: &Capture,
    key: &str,
    keeper: &RecordingObserver<'_>,
) -> Result<(Scene, Option<viewer::Packed>), Error> {
    let started = Instant::now();
    let settings = &run.job.settings;
    let gpu = run.gpu.clone();
    let make = || match &gpu {
        Some(gpu) => Ok(gpu.training(run.job.device.max_vram_mb, &settings.train_config())),
        None => Err(BackendError("no GPU was started".to_owned())),
    };
    folder::remove_file(&run.path(SCENE_FILE))?;
    // it would show another scene
    folder::remove_file(&run.path(VIEWER_FILE))?;
    run.record.files.remove(VIEWER_FILE);
    run.record.stages.remove(viewer::STAGE);
    let end = run.clock.end_of_training();
    let mut checkpoints = Checkpoints::new(&run.folder, key, settings.checkpoint.keep);
    let mut config = settings.train_config();
    let (mut trainer, mut log) = match checkpoints.latest(capture, &config, run.level, keeper)? {
        Some(trainer) => {
            let (done, total) = (trainer.iteration(), trainer.iterations());
            run.job.observer.stage(STAGE, StageEvent::Resumed { done, total });
            let log = MetricsLog::up_to(&run.path(METRICS_FILE), done);
            (trainer, log)
        }
        None => {
            folder::remove_checkpoints(&run.folder)?;
            folder::remove_file(&run.path(METRICS_FILE))?;
            let first = first_splats(run, capture, keeper)?;
            let budget_s = settings.train.budget_s;
            if budget_s > 0.0 || end.is_some() {
                let seconds = || affordable(budget_s, started, end);
                let level = run.level;
                let observer = run.job.observer;
                let stopped = || observer.cancelled();
                let fitting = |trial| {
                    let splats = &first.splats;
                    m4_train::affordable_iterations(capture, splats, &config, level, trial, seconds, &stopped)
                };
                let n = match fitting(run.gpu.as_ref().map(|_| &make as BackendMaker<'_>)) {
                    Err(error) if may_leave_gpu(run, &error) => {
                        leave_gpu(run, keeper, &error);
                        fitting(None)
                    }
                    // The training finds out whose fault that is.
                    Err(TrainError::Diverged { .. }) if run.gpu.is_some() => fitting(None),
                    other => other,
                }?;
                check_stop(observer, STAGE, true)?;
                if budget_s > 0.0 || n < config.iterations {
                    config.iterations = n;
                    let note =
                        format!("{n} iterations fit into {:.0} s here; --iterations {n} repeats this run", seconds());
                    keeper.update(STAGE, 0, n, &note);
                }
            }
            let mut trainer = Trainer::new(capture, first, config, run.level)?;
            let mut log = MetricsLog::new(&run.path(METRICS_FILE));
            // The number of iterations may have been measured: a run resumed after a kill uses the same.
            save(run, &mut trainer, &mut checkpoints, &mut log)?;
            (trainer, log)
        }
    };
    if let Some(gpu) = &run.gpu {
        trainer.use_backend(gpu.training(run.job.device.max_vram_mb, &settings.train_config()))?;
    }
    let observer = run.job.observer;
    let total = trainer.iterations();
    let every_s = settings.checkpoint.every_s;
    let mut timer = CheckpointTimer::new(keeper, observer, every_s).at_most(end);
    loop {
        let mut note = |event: &MetricsEvent| {
            log.push(event);
            observer.metrics(event, total);
        };
        // After the last step comes the fit of colours, which starts anew when it is interrupted: only the user stops it.
        let steps_are_done = trainer.iteration() == total;
        let progress: &dyn Progress = if steps_are_done { keeper } else { &timer };
        let outcome = match trainer.run(progress, &mut note) {
            Ok(outcome) => outcome,
            Err(error) if may_leave_gpu(run, &error) => {
                leave_gpu(run, keeper, &error);
                trainer.use_cpu(run.level)?;
                continue;
            }
            Err(error @ (TrainError::Diverged { .. } | TrainError::Device { .. })) => {
                // The trainer is back in its last good state: worth keeping, not worth going on with.
                save(run, &mut trainer, &mut checkpoints, &mut log)?;
                return Err(error.into());
            }
            Err(error) => return Err(error.into()),
        };
        if outcome == Outcome::Finished {
            break;
        }
        if observer.wants_scene() {
            let depth = f64::from(trainer.scale().median_depth);
            observer.scene(&mut || trainer.scene(), depth);
        }
        if !timer.stopped_by_user() && end.is_some_and(|end| Instant::now() >= end) {
            keeper.warn(&format!("the time limit ended training after {} of {total} iterations", trainer.iteration()));
            break;
        }
        if timer.stopped_by_user() || timer.is_over() {
            save(run, &mut trainer, &mut checkpoints, &mut log)?;
            if timer.stopped_by_user() {
                return Err(Error::Stopped { stage: STAGE, saved: true });
            }
            timer = CheckpointTimer::new(keeper, observer, every_s).at_most(end);
        }
        timer.take_a_step();
    }
    log.write()?;
    note_progress(&mut run.record, &trainer);
    let path = run.path(SCENE_FILE);
    let scene = trainer.into_scene();
    let run = &*run;
    let (written, packed) = rayon::join(|| publish(&path, &scene), || viewer::packed(run, &scene));
    written?;
    Ok((scene, packed))
}

/// Makes the first splats, while a GPU compiles the kernels of the training that follows.
fn first_splats(
    run: &Workspace<'_>,
    capture: &Capture,
    keeper: &RecordingObserver<'_>,
) -> Result<FirstSplats, InitError> {
    let (init, config) = (run.job.settings.init_config(), run.job.settings.train_config());
    let layout = SplatLayout { isotropic: init.isotropic, sh_degree: 0, time_degree: 0 };
    let max_vram_mb = run.job.device.max_vram_mb;
    std::thread::scope(|scope| {
        let warm_up =
            run.gpu.as_ref().map(|gpu| scope.spawn(move || gpu.warm_up(capture, layout, &config, max_vram_mb)));
        let first = m4_train::init::initialise(capture, &init, keeper);
        // nor does a driver that panics there end the run here
        drop(warm_up.map(ScopedJoinHandle::join));
        first
    })
}

/// Whether a GPU failed that the user did not ask for.
fn may_leave_gpu(run: &Workspace<'_>, error: &TrainError) -> bool {
    let failed = matches!(error, TrainError::Device { .. });
    failed && run.gpu.as_ref().is_some_and(OpenGpu::is_automatic)
}

/// Trains on the CPU from here on, which the record then names; nor does the GPU draw the preview.
fn leave_gpu(run: &mut Workspace<'_>, keeper: &RecordingObserver<'_>, error: &TrainError) {
    keeper.warn(&format!("{error}; the run goes on from there on the CPU"));
    run.gpu = None;
    run.record.device = Device::here(run.level, None);
}

/// Seconds that are left for iterations: of the budget, which the first splats have taken a part of, but at least half of it; and of
/// the time until `end`.
fn affordable(budget_s: f64, started: Instant, end: Option<Instant>) -> f64 {
    let budget_s = if budget_s > 0.0 { budget_s } else { f64::INFINITY };
    let left_s = end.map_or(f64::INFINITY, |end| end.saturating_duration_since(Instant::now()).as_secs_f64());
    (budget_s - started.elapsed().as_secs_f64()).max(0.5 * budget_s).min(left_s)
}

/// A checkpoint: the scene so far, the metrics so far, the record.
fn save(
    run: &mut Workspace<'_>,
    trainer: &mut Trainer<'_>,
    checkpoints: &mut Checkpoints,
    log: &mut MetricsLog,
) -> Result<(), Error> {
    // The log first: lines after the checkpoint are cut off again, lines that are missing would stay so.
    log.write()?;
    checkpoints.save(trainer)?;
    note_progress(&mut run.record, trainer);
    run.record.write(&run.folder)
}

fn note_progress(record: &mut RunRecord, trainer: &Trainer<'_>) {
    let splats: &Splats = trainer.splats();
    record.iterations = Some(trainer.iteration());
    record.splats = Some(SplatCount { r#static: splats.n_static(), dynamic: splats.n_dynamic() });
}

/// Writes the finished scene, reads it back and compares.
fn publish(path: &Path, scene: &Scene) -> Result<(), Error> {
    if !scene.splats.is_finite() {
        return Err(Error::Internal { what: "training ended with values that are not finite".to_owned() });
    }
    safetensors::write(path, scene, None, &BTreeMap::new())?;
    if safetensors::read(path)?.scene == *scene {
        return Ok(());
    }
    folder::remove_file(path)?;
    Err(OutputError::Verify { path: path.to_path_buf(), what: "the scene differs".to_owned() }.into())
}
