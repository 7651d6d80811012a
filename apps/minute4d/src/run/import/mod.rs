//! Imports files of other tools: splats as the folder of a run, which can be rendered, viewed and
//! exported; clips with poses as a capture, which can be trained.
//!
//! ```text
//! format   detection                       read      splats -> Scene
//! capture  a posed clip -> Capture -> written
//! ```

mod capture;
mod format;

pub use capture::CaptureReport;
pub use format::ImportFormat;
pub use m4_io::dataset::{ImportOptions, SourceFormat};

use crate::run::Clock;
use crate::run::Job;
use crate::run::record::{Source, SplatCount};
use crate::run::stage;
use crate::run::workspace::{Task, Workspace};
use m4_io::scene::{Imported, fourdgs, ply, safetensors};
use minute4d::export::{Format, Losses};
use minute4d::import::default_cameras;
use minute4d::layout::{Existing, SCENE_FILE};
use minute4d::{Error, Observer, Refusal, Settings};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Name of the stage.
pub const STAGE: &str = "import";

/// The report of an import.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImportReport {
    /// The format that was read.
    pub format: Format,
    /// The folder that was made.
    pub path: PathBuf,
    /// Splats without time parameters.
    pub splats_static: usize,
    /// Splats with them.
    pub splats_dynamic: usize,
    /// Frames of the clip.
    pub time_frames: usize,
    /// Cameras of the file; 0 where they were made up.
    pub cameras: usize,
    /// What of the file a scene cannot hold.
    pub losses: Losses,
    /// Wall-clock seconds.
    pub seconds: f64,
}

/// The report of an import.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Report {
    /// A scene.
    Scene(ImportReport),
    /// A capture.
    Capture(Box<CaptureReport>),
}

/// Imports a file or folder into the folder `out`: splats as a scene, posed clips as a capture. A
/// scene without cameras gets some that look at its middle.
///
/// # Errors
///
/// [`Error`]: the file cannot be read or is of no known format, options and format do not go together, or the folder
/// cannot be used.
pub fn make(
    file: &Path,
    out: &Path,
    job: &ImportJob,
    observer: &dyn Observer,
) -> Result<Report, Error> {
    Error::unless_exists("file to import", file)?;
    let format = ImportFormat::of(file, job.format)?;
    let splats = match format {
        ImportFormat::Scene(format) => format,
        ImportFormat::Source(source) => {
            return capture::make(file, out, source, job, observer)
                .map(|report| Report::Capture(Box::new(report)));
        }
    };
    job.refuse_options(&[], splats.name(), " files, which hold splats")?;
    scene(file, out, splats, job.existing, observer).map(Report::Scene)
}

/// A file of splats as the folder of a run.
fn scene(
    file: &Path,
    out: &Path,
    format: Format,
    existing: Existing,
    observer: &dyn Observer,
) -> Result<ImportReport, Error> {
    let job = Job::new(
        Settings::fast(),
        minute4d::device::DeviceRequest::default(),
        existing,
        observer,
    );
    // Read before the folder is made, so that a wrong file leaves nothing behind.
    let Imported {
        mut scene,
        up,
        losses,
    } = read(format, file)?;
    if scene.splats.n() == 0 {
        return Err(Refusal::bad_input(format!("{} contains no splats", file.display())).into());
    }
    let cameras = scene.source.len();
    if cameras == 0 {
        default_cameras(&mut scene, up);
    }
    let source = Source::read(file, None, observer)?;
    let key = stage::key(STAGE, &[&source.blake3, format.name()]);
    let run = Workspace::open(out, &source, &job, Clock::start(&job.settings))?;
    let record = run.finish(|run| {
        run.record.profile = STAGE.to_owned();
        run.record.splats = Some(SplatCount {
            r#static: scene.splats.n_static(),
            dynamic: scene.splats.n_dynamic(),
        });
        run.stage(STAGE, Task::new(key), &[SCENE_FILE], |run, keeper| {
            use m4_core::Progress;
            for loss in &losses {
                keeper.warn(&loss.to_string());
            }
            if cameras == 0 {
                keeper.warn("the file has no cameras; a default path around its centre is used");
            }
            let path = run.path(SCENE_FILE);
            Ok(safetensors::write(&path, &scene, None, &BTreeMap::new())?)
        })
    })?;
    Ok(ImportReport {
        format,
        path: out.to_path_buf(),
        splats_static: scene.splats.n_static(),
        splats_dynamic: scene.splats.n_dynamic(),
        time_frames: scene.time_frames,
        cameras,
        losses: Losses::of(losses),
        seconds: record.seconds,
    })
}

/// What to import, and what its files do not say.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportJob {
    /// The format; `None` for what the name or the files of a folder say.
    pub format: Option<ImportFormat>,
    /// What to do with a folder that holds something.
    pub existing: Existing,
    /// Of captures.
    pub options: ImportOptions,
}

impl ImportJob {
    /// Everything as the files say.
    pub fn new(format: Option<ImportFormat>) -> Self {
        Self {
            format,
            existing: Existing::Refuse,
            options: ImportOptions::default(),
        }
    }

    /// Refuses options that were given, but for those in `allowed`; `has` says what the format has
    /// instead of their meaning.
    fn refuse_options(&self, allowed: &[&str], format: &str, has: &str) -> Result<(), Refusal> {
        let (o, d) = (&self.options, ImportOptions::default());
        let options = [
            ("--fps", o.fps != d.fps),
            ("--images", o.images != d.images),
            ("--depth", o.depth != d.depth),
            ("--masks", o.masks != d.masks),
            ("--factor", o.factor != d.factor),
            ("--allow-outside", o.reach != d.reach),
        ];
        let mut given = options
            .iter()
            .filter(|(name, is_given)| *is_given && !allowed.contains(name));
        given.next().map_or(Ok(()), |(option, _)| {
            Err(Refusal::usage(format!(
                "{option} has no meaning for {format}{has}; leave it out"
            )))
        })
    }
}

fn read(format: Format, path: &Path) -> Result<Imported, Error> {
    match format {
        Format::Fourdgs => Ok(fourdgs::read(path)?),
        Format::Ply => Ok(ply::read(path)?),
        _ => Err(format::write_only(format).into()),
    }
}
