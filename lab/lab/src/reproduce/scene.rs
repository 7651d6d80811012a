//! One scene by one protocol.
//!
//! ```text
//! OUT/captures/SCENE              the data set's own poses and depth, or geometry of its video; shared by protocols
//! OUT/captures-own/SCENE          geometry estimated from its training images, with --geometry own
//! OUT/PROTOCOL/SCENE/capture      the split, if the protocol holds out frames of the video
//! OUT/PROTOCOL/SCENE/run          a run as of `minute4d train`, with eval.json
//! OUT/PROTOCOL/SCENE/row.json     the row of the table and its key: written last
//! OUT/PROTOCOL/SCENE/ablation     as of `minute4d ablate`
//! ```

use super::report::SceneRow;
use super::suite::{FoundScene, Suite};
use super::{GeometrySource, ReproduceOptions};
use m4_io::capture::{self, Split};
use m4_io::dataset::{ImportOptions, SourceFormat};
use m4_io::files;
use m4_io::results::{Kind, ResultFolder};
use minute4d::OutputError;
use minute4d::json::{MAX_RECORD_BYTES, write_json};
use minute4d::layout::{self, EVAL_FILE, Existing};
use minute4d::{Refusal, hash};
use minute4d_cli::run::Job;
use minute4d_cli::run::record::RunRecord;
use minute4d_cli::run::{self, geometry};
use minute4d_eval::Error;
use minute4d_eval::{
    self as evaluate, EvalOptions, EvalReport, FrameRule, PoseTreatment, Protocol,
};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

const ROW_FILE: &str = "row.json";
/// Says of what data a capture was imported.
const KEY_FILE: &str = "import.json";
/// Frames a second of the clips of DAVIS.
const DAVIS_FPS: f64 = 24.0;
const HINT: &str = "also download the images that results are compared with";

/// `row.json`.
#[derive(Serialize, Deserialize)]
struct CachedRow {
    key: String,
    row: SceneRow,
}

/// `import.json`.
#[derive(Serialize, Deserialize)]
struct Imported {
    key: String,
}

/// A scene by a protocol, with its folders.
pub(super) struct SceneResult {
    pub row: SceneRow,
    /// `OUT/PROTOCOL/SCENE`.
    pub folder: PathBuf,
    /// The capture that was trained.
    pub capture: PathBuf,
    /// The capture with the views that were scored.
    pub views: PathBuf,
}

/// A scene, as it was kept or made now.
pub(super) fn make(
    suite: Suite,
    scene: &FoundScene,
    protocol: Protocol,
    out: &Path,
    options: &ReproduceOptions,
    job: &Job<'_>,
) -> Result<SceneResult, Error> {
    let folder = out.join(protocol.name()).join(&scene.name);
    let source = fingerprint(&scene.path)?;
    let key = hash::of_parts(&[
        env!("CARGO_PKG_VERSION"),
        protocol.name(),
        &source,
        &job.settings.to_toml()?,
        &job.device.choice.to_string(),
        &format!(
            "{:?} {} {:?}",
            options.factor, options.refine_poses, options.geometry
        ),
    ]);
    let file = folder.join(ROW_FILE);
    let run = folder.join("run");
    let mut settings = job.settings.clone();
    // they are not needed
    settings.viewer.write = false;
    if suite == Suite::Davis {
        settings.video.folder_fps = DAVIS_FPS;
    }
    let job = Job {
        settings,
        existing: Existing::Resume,
        ..*job
    };
    let whole = out.join("captures").join(&scene.name);
    let own = options.geometry == GeometrySource::Own && suite != Suite::Davis;
    let trained = if own {
        out.join("captures-own").join(&scene.name)
    } else {
        whole.clone()
    };
    let splits = protocol.rules().frames != FrameRule::TestSplit;
    let part = folder.join("capture");
    let (data, views) = if splits {
        (part.clone(), part)
    } else {
        (trained.clone(), whole.clone())
    };
    let result_of = |row| SceneResult {
        row,
        folder: folder.clone(),
        capture: data.clone(),
        views: views.clone(),
    };
    if let Some(cache) = read::<CachedRow>(&file)
        && cache.key == key
        && run.join(EVAL_FILE).is_file()
    {
        return Ok(result_of(cache.row));
    }
    layout::claim(&folder, Kind::Report, &[ROW_FILE])?;
    layout::remove_file(&file)?;
    let mut geometry_s = whole_capture(suite, scene, &source, &whole, options, &job)?;
    if own {
        geometry_s = Some(own_geometry(&whole, &trained, &job)?);
    }
    if splits {
        evaluate::split(
            &trained,
            protocol,
            &data,
            Existing::Resume,
            job.settings.capture.reach,
            job.observer,
        )?;
    } else if !whole.join(Split::Test.file_name()).is_file() {
        let path = scene.path.display();
        let message =
            format!("{path} has no held-out views, which the protocol {protocol} scores; {HINT}");
        return Err(Refusal::bad_input(message).into());
    }
    let record = run::train::make(&data, &run, &job, false)?;
    let judging = EvalOptions {
        device: job.device.choice,
        protocol: Some(protocol),
        refine_poses: options.refine_poses && protocol.rules().refine.is_some(),
        ..EvalOptions::default()
    };
    let report = evaluate::views(&run, &views, &judging, job.observer)?;
    let treatment = report
        .choices
        .as_ref()
        .map(|choices| choices.poses.treatment);
    if own && !splits && treatment == Some(PoseTreatment::Given) {
        return Err(Refusal::bad_input(format!(
            "the cameras found from the images of {} do not align with those of the data set, so its views cannot be placed; train with \
             --geometry given",
            scene.path.display()
        ))
        .into());
    }
    let row = row(scene, &report, &record, geometry_s)?;
    write_json(
        &file,
        &CachedRow {
            key,
            row: row.clone(),
        },
    )?;
    Ok(result_of(row))
}

/// Geometry from the training images alone, as they lie in the capture that was imported; its
/// seconds.
fn own_geometry(imported: &Path, out: &Path, job: &Job<'_>) -> Result<f64, Error> {
    let mut settings = job.settings.clone();
    let options = &settings.capture;
    let train = capture::read(imported, Split::Train, options, job.observer)?;
    let n = train.frames.len();
    let even = |(i, frame): (usize, &m4_core::CaptureFrame)| (frame.t - i as f64).abs() < 0.25;
    if train.time_frames != n || !train.frames.iter().enumerate().all(even) {
        return Err(Refusal::bad_input(format!(
            "the training images of {} are not evenly spaced in time, as geometry from images alone assumes; omit --geometry own",
            imported.display()
        ))
        .into());
    }
    if let Some(duration_s) = train.duration_s.filter(|d| *d > 0.0 && n > 1) {
        settings.video.folder_fps = (n - 1) as f64 / duration_s;
    }
    drop(train);
    let [images, ..] = Split::Train.folders();
    let job = Job {
        settings,
        existing: Existing::Resume,
        ..*job
    };
    Ok(geometry::make(&imported.join(images), out, &job)?.seconds)
}

/// The capture of a scene with all its frames, made if it is missing; seconds of its geometry where
/// that was estimated.
fn whole_capture(
    suite: Suite,
    scene: &FoundScene,
    source: &str,
    whole: &Path,
    options: &ReproduceOptions,
    job: &Job<'_>,
) -> Result<Option<f64>, Error> {
    let format = match suite {
        Suite::Dycheck => SourceFormat::Dycheck,
        Suite::Nvidia => SourceFormat::Nvidia,
        Suite::Davis => return Ok(Some(geometry::make(&scene.path, whole, job)?.seconds)),
    };
    let key = hash::of_parts(&[
        env!("CARGO_PKG_VERSION"),
        source,
        &format!("{:?}", options.factor),
    ]);
    let file = whole.join(KEY_FILE);
    if read::<Imported>(&file).is_some_and(|cache| cache.key == key) {
        return Ok(None);
    }
    let mut results = ResultFolder::open(whole, Kind::Capture)?;
    if !results.is_empty() && !file.is_file() {
        return Err(OutputError::NotOurs {
            path: whole.to_path_buf(),
            missing: KEY_FILE,
        }
        .into());
    }
    results.check_free(layout::capture_names().chain([KEY_FILE]))?;
    let import = ImportOptions {
        factor: options.factor,
        max_memory_bytes: job.settings.capture.max_memory_bytes,
        reach: job.settings.capture.reach,
        ..ImportOptions::default()
    };
    let read = m4_io::dataset::read(&scene.path, format, &import, job.observer)?;
    let source = (scene.path.as_path(), format);
    let next = results.begin()?;
    minute4d::import::write_capture(&next, &read, source, options.factor, job.observer)?;
    write_json(&next.join(KEY_FILE), &Imported { key })?;
    results.commit(None)?;
    Ok(None)
}

/// The name of a pose treatment in tables.
fn pose_word(treatment: PoseTreatment) -> &'static str {
    match treatment {
        PoseTreatment::Given => "given",
        PoseTreatment::Sim3Aligned => "aligned",
        PoseTreatment::Refined => "refined",
    }
}

fn row(
    scene: &FoundScene,
    report: &EvalReport,
    record: &RunRecord,
    geometry_s: Option<f64>,
) -> Result<SceneRow, Error> {
    let lacks = |what: &str| minute4d::Error::Internal {
        what: format!("the report of {} has no {what}", scene.name),
    };
    let choices = report.choices.as_ref().ok_or_else(|| lacks("choices"))?;
    let mean = report.mean.ok_or_else(|| lacks("mean"))?;
    let others = report
        .mean_others
        .iter()
        .map(|(name, m)| (name.clone(), m.mean));
    Ok(SceneRow {
        scene: scene.name.clone(),
        views: mean.frames,
        headline: choices.headline.mean,
        psnr_db: mean.psnr_db,
        ssim: mean.ssim,
        others: others.collect(),
        poses: match (geometry_s, choices.poses.treatment) {
            (None, treatment) => pose_word(treatment).to_owned(),
            (Some(_), PoseTreatment::Given) => "own".to_owned(),
            (Some(_), treatment) => format!("own, {}", pose_word(treatment)),
        },
        mask: match choices.mask.source {
            evaluate::MaskSource::None => "whole images,".to_owned(),
            evaluate::MaskSource::Files => "published co-visibility masks,".to_owned(),
            evaluate::MaskSource::Computed => "co-visibility masks made here,".to_owned(),
        },
        size_px: choices.resolution.scored_px,
        train_s: record
            .stages
            .get(run::train::STAGE)
            .map(|stage| stage.seconds),
        geometry_s,
        iterations: record.iterations,
        splats: report.splats,
        frames_per_s: report.frames_per_s,
        device: report.device.clone(),
    })
}

fn read<T: for<'a> Deserialize<'a>>(path: &Path) -> Option<T> {
    serde_json::from_slice(&files::read(path, MAX_RECORD_BYTES).ok()?).ok()
}

/// Names, sizes and times of all files below a folder: reading them all would take longer than
/// training does.
fn fingerprint(folder: &Path) -> Result<String, Error> {
    let mut parts = Vec::new();
    let mut open = vec![folder.to_path_buf()];
    let failed = |path: &Path| {
        let path = path.to_path_buf();
        move |source| minute4d::Error::Read { path, source }
    };
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(&next).map_err(failed(&next))? {
            let path: PathBuf = entry.map_err(failed(&next))?.path();
            let meta = fs::metadata(&path).map_err(failed(&path))?;
            if meta.is_dir() {
                open.push(path);
                continue;
            }
            let modified = meta
                .modified()
                .ok()
                .and_then(|t| t.duration_since(UNIX_EPOCH).ok());
            let name = path
                .strip_prefix(folder)
                .unwrap_or(&path)
                .display()
                .to_string();
            parts.push(format!(
                "{name} {} {}",
                meta.len(),
                modified.map_or(0, |t| t.as_nanos())
            ));
        }
    }
    parts.sort();
    Ok(hash::of_parts(
        &parts.iter().map(String::as_str).collect::<Vec<_>>(),
    ))
}
