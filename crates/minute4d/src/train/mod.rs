//! Second stage: a capture to a scene.

mod checkpoint;
mod metrics;

use crate::device::OpenGpu;
use crate::folder::{self, METRICS_FILE, SCENE_FILE, VIEWER_FILE};
use crate::progress::Keeper;
use crate::record::{Input, RunRecord, SplatCount};
use crate::settings::part_to_toml;
use crate::workspace::{Task, Workspace};
use crate::{Error, Job, Observer, Settings, StageEvent, hash, preview, viewer};
use checkpoint::{Checkpoints, Patience};
use m4_io::capture::Split;
use m4_io::scene_file;
use m4_scene::{Capture, Progress, Scene, Splats, TrainState};
use m4_train::{DeviceError, DeviceMaker, MetricsEvent, Outcome, TrainError, Trainer};
use metrics::MetricsLog;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Name of the stage.
pub const STAGE: &str = "train";

/// The settings that this stage depends on.
#[derive(Serialize)]
struct Part<'a> {
    init: &'a m4_init::InitConfig,
    train: &'a m4_train::TrainConfig,
}

/// Trains a scene on a capture and makes the preview, or goes on where that was stopped.
///
/// # Errors
///
/// [`Error`]: the capture cannot be used, the folder cannot be used, or the user asked to stop.
pub fn make(capture: &Path, out: &Path, job: &Job<'_>) -> Result<RunRecord, Error> {
    if !capture.exists() {
        return Err(Error::Missing {
            what: "capture",
            path: capture.to_path_buf(),
        });
    }
    job.check()?;
    // Read before the folder is made, so that a wrong path leaves nothing behind.
    let data = read(capture, &job.settings, job.observer)?;
    let input = Input {
        path: capture.display().to_string(),
        blake3: hash::of_capture(&data),
    };
    Workspace::open(out, input, job)?.finish(|run| {
        let scene = stage(run, &data)?;
        preview::stage(run, &data, &scene)?;
        viewer::stage(run, &data, &scene)
    })
}

/// Reads the training frames of a capture.
pub(crate) fn read(capture: &Path, settings: &Settings, observer: &dyn Observer) -> Result<Capture, Error> {
    Ok(m4_io::capture::read(
        capture,
        Split::Train,
        &settings.capture,
        observer,
    )?)
}

/// Trains within a run, unless that was done before.
pub(crate) fn stage(run: &mut Workspace<'_>, capture: &Capture) -> Result<Scene, Error> {
    let part = Part {
        init: &run.job.settings.init,
        train: &run.job.settings.train,
    };
    let (capture_hash, part) = (hash::of_capture(capture), part_to_toml(&part)?);
    let mut parts = vec![STAGE, env!("CARGO_PKG_VERSION"), &capture_hash, run.level.name(), &part];
    // last digits are the device's own
    parts.extend(run.gpu.as_ref().map(OpenGpu::name));
    let key = hash::of_parts(&parts);
    let files = [SCENE_FILE, METRICS_FILE];
    let task = run.task(STAGE, &key, &files)?;
    let (because, seconds) = match task {
        Task::Reuse => {
            run.job.observer.stage(STAGE, StageEvent::Reused);
            return Ok(scene_file::read(&run.path(SCENE_FILE))?.scene);
        }
        Task::Work {
            because,
            seconds_before,
        } => (because, seconds_before),
    };
    let same_key = key.clone();
    run.stage(STAGE, key, (because, seconds), &files, |run, keeper| {
        train(run, capture, &same_key, keeper)
    })
}

fn train(run: &mut Workspace<'_>, capture: &Capture, key: &str, keeper: &Keeper<'_>) -> Result<Scene, Error> {
    let settings = &run.job.settings;
    let gpu = run.gpu.clone();
    let make = || match &gpu {
        Some(gpu) => gpu.training(run.job.device.max_vram_mb, settings.train.batch),
        None => Err(DeviceError("no GPU was started".to_owned())),
    };
    folder::remove_file(&run.path(SCENE_FILE))?;
    // it would show another scene
    folder::remove_file(&run.path(VIEWER_FILE))?;
    run.record.files.remove(VIEWER_FILE);
    run.record.stages.remove(viewer::STAGE);
    let mut checkpoints = Checkpoints::new(&run.folder, key, settings.checkpoint.keep);
    let (mut trainer, mut log) = match checkpoints.latest(capture, &settings.train, run.level, keeper)? {
        Some(trainer) => {
            let (done, total) = (trainer.iteration(), trainer.iterations());
            run.job.observer.stage(STAGE, StageEvent::Resumed { done, total });
            let log = MetricsLog::up_to(&run.path(METRICS_FILE), done);
            (trainer, log)
        }
        None => {
            folder::remove_checkpoints(&run.folder)?;
            folder::remove_file(&run.path(METRICS_FILE))?;
            let splats = m4_init::initialise(capture, &settings.init, keeper)?;
            let mut config = settings.train.clone();
            if config.budget_s > 0.0 {
                let trial = run.gpu.as_ref().map(|_| &make as DeviceMaker<'_>);
                config.iterations =
                    m4_train::affordable_iterations(capture, &splats, &config, run.level, trial, config.budget_s)?;
                let (n, s) = (config.iterations, config.budget_s);
                let note = format!("{n} iterations fit into {s:.0} s here; --iterations {n} repeats this run");
                keeper.update(STAGE, 0, n, &note);
            }
            let trainer = Trainer::new(capture, splats, config, run.level)?;
            (trainer, MetricsLog::new(&run.path(METRICS_FILE)))
        }
    };
    if gpu.is_some() {
        let device = make().map_err(|DeviceError(why)| TrainError::Device {
            why,
            iteration: trainer.iteration(),
            good_iteration: trainer.iteration(),
        })?;
        trainer.use_device(device);
    }
    let observer = run.job.observer;
    let total = trainer.iterations();
    let mut patience = Patience::new(keeper, observer, settings.checkpoint.every_s);
    loop {
        let mut note = |event: &MetricsEvent| {
            log.push(event);
            observer.metrics(event, total);
        };
        let outcome = match trainer.run(&patience, &mut note) {
            Ok(outcome) => outcome,
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
        if patience.stopped_by_user() || patience.is_over() {
            save(run, &mut trainer, &mut checkpoints, &mut log)?;
            if patience.stopped_by_user() {
                return Err(Error::Stopped {
                    stage: STAGE,
                    saved: true,
                });
            }
            patience = Patience::new(keeper, observer, settings.checkpoint.every_s);
        }
        patience.take_a_step();
    }
    log.write()?;
    note_progress(&mut run.record, &trainer);
    let path = run.path(SCENE_FILE);
    trainer.save(|scene, state| publish(&path, scene, state))?;
    folder::remove_checkpoints(&run.folder)?;
    Ok(trainer.into_scene())
}

/// A checkpoint: the scene so far, the metrics so far, the record.
fn save(
    run: &mut Workspace<'_>,
    trainer: &mut Trainer<'_>,
    checkpoints: &mut Checkpoints,
    log: &mut MetricsLog,
) -> Result<(), Error> {
    checkpoints.save(trainer)?;
    log.write()?;
    note_progress(&mut run.record, trainer);
    run.record.write(&run.folder)
}

fn note_progress(record: &mut RunRecord, trainer: &Trainer<'_>) {
    let splats: &Splats = trainer.splats();
    record.iterations = Some(trainer.iteration());
    record.splats = Some(SplatCount {
        r#static: splats.n_static(),
        dynamic: splats.n_dynamic(),
    });
}

/// Writes the finished scene with the state of the optimiser, reads both back and compares: only then is it
/// a success.
fn publish(path: &Path, scene: &Scene, state: &TrainState<'_>) -> Result<(), Error> {
    if !scene.splats.is_finite() {
        return Err(Error::Internal {
            what: "training ended with values that are not finite".to_owned(),
        });
    }
    scene_file::write(path, scene, Some(state), &BTreeMap::new())?;
    let back = scene_file::read(path)?;
    let differs = if back.scene != *scene {
        "the scene differs"
    } else if back.state.as_ref() != Some(state) {
        "the state of the optimiser differs"
    } else {
        return Ok(());
    };
    folder::remove_file(path)?;
    Err(Error::Verify {
        path: path.to_path_buf(),
        what: differs.to_owned(),
    })
}
