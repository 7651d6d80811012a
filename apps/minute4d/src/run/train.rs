//! The second stage: trains a scene from a capture on disk.

use super::checkpoint::{Checkpoints, MetricsLog};
use super::clock::Clock;
use super::folder;
use super::record::{Device, RunRecord, Source, SplatCount};
use super::workspace::Workspace;
use super::{Job, preview, stage, viewer};
use m4_core::{Capture, Progress, Scene};
use m4_io::capture::Split;
use m4_io::scene::safetensors;
use m4_kernels::SimdLevel;
use m4_train::{MetricsEvent, TrainConfig, Trainer};
use minute4d::OutputError;
use minute4d::device::OpenGpu;
use minute4d::hash::HashedCapture;
use minute4d::layout::{self, METRICS_FILE, SCENE_FILE, VIEWER_FILE};
use minute4d::observer::RecordingObserver;
use minute4d::settings::{InitSettings, Profile, TrainSettings, part_to_toml};
pub use minute4d::train::STAGE;
use minute4d::train::{TrainStore, Training, compute};
use minute4d::{Error, Observer, Settings, StageEvent};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// The settings that this stage depends on.
#[derive(Serialize)]
struct Dependencies<'a> {
    profile: Profile,
    init: &'a InitSettings,
    train: &'a TrainSettings,
}

/// Trains a scene on a capture and makes the preview, or resumes a stopped run; with a poster where
/// it is asked for.
///
/// # Errors
///
/// [`Error`]: the capture cannot be used, the folder cannot be used, or the user asked to stop.
pub fn make(capture: &Path, out: &Path, job: &Job<'_>, poster: bool) -> Result<RunRecord, Error> {
    Error::unless_exists("capture", capture)?;
    job.check()?;
    let clock = Clock::start(&job.settings);
    // Read before the folder is made, so that a wrong path leaves nothing behind.
    let data = read(capture, &job.settings, job.observer)?;
    let data = HashedCapture::new(data);
    let source = Source {
        path: capture,
        blake3: data.hash.clone(),
    };
    Workspace::open(out, &source, job, clock)?.finish(|run| all(run, &data, poster))
}

/// Trains; writes preview and viewer if time remains, and a poster where it is asked for.
pub(crate) fn all(
    run: &mut Workspace<'_>,
    capture: &HashedCapture,
    poster: bool,
) -> Result<(), Error> {
    let (scene, packed) = trained(run, capture)?;
    let plan = viewer::plan(run, capture)?;
    let wanted = matches!(plan, viewer::Plan::Write(_)) && !run.clock.is_over();
    // The page is made while the preview is drawn; a scene of an earlier run is packed now.
    let packed = if wanted {
        packed.or_else(|| viewer::packed(run, &scene))
    } else {
        None
    };
    let (preview, page) = rayon::join(
        || run.if_there_is_time("a preview", |run| preview::make(run, capture, &scene)),
        || {
            packed
                .map(|packed| viewer::Page::new(packed, &capture.capture, &scene))
                .transpose()
        },
    );
    preview?;
    run.if_there_is_time("the page", |run| viewer::make(run, plan, page?))?;
    match poster {
        true => preview::poster(run, &capture.capture, &scene),
        false => Ok(()),
    }
}

/// Reads the training frames of a capture.
pub(crate) fn read(
    capture: &Path,
    settings: &Settings,
    observer: &dyn Observer,
) -> Result<Capture, Error> {
    Ok(m4_io::capture::read(
        capture,
        Split::Train,
        &settings.capture,
        observer,
    )?)
}

/// Trains within a run, unless that was done before. Returns the scene, and the splats for its page
/// where they were packed as well.
fn trained(
    run: &mut Workspace<'_>,
    capture: &HashedCapture,
) -> Result<(Scene, Option<viewer::Packed>), Error> {
    let settings = &run.job.settings;
    let part = part_to_toml(&Dependencies {
        profile: settings.profile,
        init: &settings.init,
        train: &settings.train,
    })?;
    let mut parts = vec![capture.hash.as_str(), run.level.name(), &part];
    // last digits are the device's own
    parts.extend(run.gpu.as_ref().map(OpenGpu::name));
    let key = stage::key(STAGE, &parts);
    let files = [SCENE_FILE, METRICS_FILE];
    let Some(task) = run.task(STAGE, key.clone(), &files)? else {
        run.job.observer.stage(STAGE, StageEvent::Reused);
        return Ok((safetensors::read(&run.path(SCENE_FILE))?.scene, None));
    };
    let result = run.stage(STAGE, task, &files, |run, keeper| {
        train(run, &capture.capture, &key, keeper)
    })?;
    // Only now: until the record says that the scene is whole, they are what a killed run continues
    // from.
    folder::remove_checkpoints(&run.folder)?;
    Ok(result)
}

fn train(
    run: &mut Workspace<'_>,
    capture: &Capture,
    key: &str,
    keeper: &RecordingObserver<'_>,
) -> Result<(Scene, Option<viewer::Packed>), Error> {
    layout::remove_file(&run.path(SCENE_FILE))?;
    // it would show another scene
    layout::remove_file(&run.path(VIEWER_FILE))?;
    run.record.files.remove(VIEWER_FILE);
    run.record.stages.remove(viewer::STAGE);
    let job = run.job;
    let mut training = Training {
        settings: &job.settings,
        level: run.level,
        gpu: run.gpu.clone(),
        max_vram_mb: job.device.max_vram_mb,
        end: run.clock.end_of_training(),
    };
    let mut state = State {
        checkpoints: Checkpoints::new(&run.folder, key, job.settings.checkpoint.keep),
        log: MetricsLog::new(&run.path(METRICS_FILE)),
        run,
    };
    let trained = compute(capture, &mut training, &mut state, keeper);
    run.gpu = training.gpu;
    let scene = trained?;
    let path = run.path(SCENE_FILE);
    let run = &*run;
    let (written, packed) = rayon::join(|| publish(&path, &scene), || viewer::packed(run, &scene));
    written?;
    Ok((scene, packed))
}

/// The state of training in the folder of a run: checkpoints, the metrics so far, the record.
struct State<'s, 'r> {
    run: &'s mut Workspace<'r>,
    checkpoints: Checkpoints,
    log: MetricsLog,
}

impl TrainStore for State<'_, '_> {
    fn resume<'c>(
        &mut self,
        capture: &'c Capture,
        config: &TrainConfig,
        level: SimdLevel,
        progress: &dyn Progress,
    ) -> Result<Option<Trainer<'c>>, Error> {
        let trainer = self.checkpoints.latest(capture, config, level, progress)?;
        if let Some(trainer) = &trainer {
            self.log = MetricsLog::up_to(&self.run.path(METRICS_FILE), trainer.iteration());
        }
        Ok(trainer)
    }

    fn begin(&mut self) -> Result<(), Error> {
        folder::remove_checkpoints(&self.run.folder)?;
        layout::remove_file(&self.run.path(METRICS_FILE))
    }

    fn event(&mut self, event: &MetricsEvent) {
        self.log.push(event);
    }

    fn save(&mut self, trainer: &mut Trainer<'_>) -> Result<(), Error> {
        // The log first: lines after the checkpoint are cut off again, lines that are missing would
        // stay so.
        self.log.write()?;
        self.checkpoints.save(trainer)?;
        note_progress(&mut self.run.record, trainer);
        self.run.record.write(&self.run.folder)
    }

    fn finish(&mut self, trainer: &Trainer<'_>) -> Result<(), Error> {
        self.log.write()?;
        note_progress(&mut self.run.record, trainer);
        Ok(())
    }

    fn left_gpu(&mut self) {
        // nor does the GPU draw the preview
        self.run.record.device = Device::here(self.run.level, None);
    }
}

fn note_progress(record: &mut RunRecord, trainer: &Trainer<'_>) {
    let splats = trainer.splats();
    record.iterations = Some(trainer.iteration());
    record.splats = Some(SplatCount {
        r#static: splats.n_static(),
        dynamic: splats.n_dynamic(),
    });
}

/// Writes the finished scene, reads it back and compares.
fn publish(path: &Path, scene: &Scene) -> Result<(), Error> {
    if !scene.splats.is_finite() {
        let what = "training ended with values that are not finite";
        return Err(Error::internal(what));
    }
    safetensors::write(path, scene, None, &BTreeMap::new())?;
    if safetensors::read(path)?.scene == *scene {
        return Ok(());
    }
    layout::remove_file(path)?;
    Err(OutputError::Verify {
        path: path.to_path_buf(),
        what: "the scene differs".to_owned(),
    }
    .into())
}
