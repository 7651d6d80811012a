//! Exports a scene for other tools, and reports bytes, seconds, and the loss in decibels against our own rendering.
//!
//! Adding a format: a variant of [`Format`] with its row in `format.rs`, an arm in `write.rs`, and, where
//! there is a reader, one in `crate::import`. Formats of captures have an arm in `capture.rs` instead.

mod bake;
mod format;
mod report;
mod write;

pub use format::{Format, Time};
pub use report::{Comparison, ExportReport, Losses};

use crate::error::OutputError;
use crate::folder::SCENE_FILE;
use crate::render::{Moment, Span};
use crate::{Category, Error, Observer, is_capture};
use m4_core::Scene;
use m4_io::dataset::export::WriteCaptureAsError;
use m4_io::scene::{WriteFileError, safetensors};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// An export job.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportJob {
    /// The format.
    pub format: Format,
    /// Where to; `None` for the usual name beside the scene.
    pub out: Option<PathBuf>,
    /// The moment of a format that has one; `None` for the middle of the clip.
    pub time: Option<Moment>,
    /// Frames a second of a format that has many; `None` for those of the source.
    pub fps: Option<f64>,
    /// Replace what is there.
    pub replace: bool,
    /// Render what was written and compare it with the scene.
    pub compare: bool,
    /// Leave the opacities as they were trained, for players with a Mip filter and for [`crate::import`]; else
    /// what the filter does to them is baked into them.
    pub keep_mip: bool,
    /// Which files a capture may name.
    pub reach: m4_io::reach::Reach,
    /// Settings of single formats.
    pub fourdgs: m4_io::scene::fourdgs::FourdgsConfig,
}

impl ExportJob {
    /// The format as it is by itself.
    #[must_use]
    pub fn new(format: Format) -> Self {
        Self {
            format,
            out: None,
            time: None,
            fps: None,
            replace: false,
            compare: true,
            keep_mip: false,
            reach: m4_io::reach::Reach::Inside,
            fourdgs: m4_io::scene::fourdgs::FourdgsConfig::default(),
        }
    }
}

/// Exports a scene (a file, or the folder of a run) or, in a format of captures, a capture.
///
/// # Errors
///
/// [`Error`]: the scene cannot be read, the moment lies outside it, options and format do not go together,
/// or the file cannot be written.
pub fn make(input: &Path, job: &ExportJob, observer: &dyn Observer) -> Result<ExportReport, Error> {
    job.check()?;
    let lone_capture = is_capture(input) && !input.join(SCENE_FILE).is_file();
    if job.format.takes_capture() {
        if is_capture(input) {
            return write::make_capture(input, job, observer);
        }
        return Err(ExportError::NeedsCapture { format: job.format }.into());
    }
    if lone_capture {
        return Err(ExportError::NeedsScene {
            format: job.format,
            path: input.to_path_buf(),
        }
        .into());
    }
    let (folder, file) = if input.is_dir() {
        (input.to_path_buf(), input.join(SCENE_FILE))
    } else {
        let folder = input.parent().unwrap_or(Path::new("")).to_path_buf();
        (folder, input.to_path_buf())
    };
    let out = match &job.out {
        Some(out) => out.clone(),
        None => folder.join(job.format.file_name()),
    };
    if !job.replace && occupied(&out) {
        return Err(OutputError::WouldReplace { path: out }.into());
    }
    let scene = safetensors::read(&file)?.scene;
    scene_to(&scene, &out, job, observer)
}

/// Exports a scene in memory to `out`; what is there is replaced.
///
/// # Errors
///
/// As [`make`].
pub fn scene_to(scene: &Scene, out: &Path, job: &ExportJob, observer: &dyn Observer) -> Result<ExportReport, Error> {
    job.check()?;
    let moments = job.moments(scene)?;
    let start = Instant::now();
    let has_splats = job.format.time() != Time::Video;
    let baked = if has_splats && !job.keep_mip {
        bake::bake(scene)
    } else {
        None
    };
    let (plain, loss) = baked.unzip();
    let mut written = write::write(plain.as_ref().unwrap_or(scene), out, &moments, job, observer)?;
    written.losses.splice(0..0, loss);
    drop(plain);
    let encode_s = start.elapsed().as_secs_f64();
    let comparison = if job.compare {
        report::compare(scene, &written.path, job.format, &moments, observer)?
    } else {
        None
    };
    Ok(ExportReport::new(
        scene, job.format, &moments, written, encode_s, comparison,
    ))
}

impl ExportJob {
    fn check(&self) -> Result<(), ExportError> {
        let time = self.format.time();
        if self.time.is_some() && time != Time::Instant {
            return Err(ExportError::NoInstant { format: self.format });
        }
        let is_sampled = matches!(time, Time::Sequence | Time::Video);
        if self.fps.is_some() && !is_sampled {
            return Err(ExportError::NoRate { format: self.format });
        }
        Ok(())
    }

    /// The moments that are written, frames: one, or those of a sequence; none for a format with time.
    fn moments(&self, scene: &Scene) -> Result<Vec<f64>, Error> {
        let span = Span {
            time_frames: scene.time_frames,
            duration_s: scene.duration_s,
        };
        let last = scene.time_frames.saturating_sub(1) as f64;
        match self.format.time() {
            Time::Instant => Ok(vec![match self.time {
                Some(moment) => span.frames(moment)?,
                None => (last / 2.0).round(),
            }]),
            Time::Sequence => {
                // as many frames of the scene from one file to the next
                let step = self.fps.map_or(1.0, |fps| crate::render::source_fps(scene) / fps);
                let count = (last / step + 1e-9).floor() as usize + 1;
                Ok((0..count).map(|i| (i as f64 * step).min(last)).collect())
            }
            Time::Clip | Time::Video | Time::Capture => Ok(Vec::new()),
        }
    }
}

/// True for a file, and for a folder with something in it.
fn occupied(path: &Path) -> bool {
    match std::fs::read_dir(path) {
        Ok(mut entries) => entries.next().is_some(),
        Err(_) => path.exists(),
    }
}

/// Why an export failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// A moment for a format that has all of them.
    #[error("--time has no meaning for {}, which holds the whole clip; leave it out, or choose a format of one instant such as ply", format.name())]
    NoInstant {
        /// The format.
        format: Format,
    },
    /// A rate for a format without frames.
    #[error("--fps has no meaning for {}; leave it out, or choose ply-sequence or mp4", format.name())]
    NoRate {
        /// The format.
        format: Format,
    },
    /// A capture for a format that holds a scene.
    #[error("{} is a capture, which the format {} cannot store; choose colmap or nerfstudio, or train it first (`minute4d train`)", path.display(), format.name())]
    NeedsScene {
        /// The format.
        format: Format,
        /// The capture.
        path: PathBuf,
    },
    /// A scene for a format that holds a capture.
    #[error("the format {} stores captures, not scenes; give the folder of a capture, or choose a format of scenes such as ply", format.name())]
    NeedsCapture {
        /// The format.
        format: Format,
    },
    /// A format that is not known.
    #[error("{given:?} is not a format; choose one of {}", Format::names())]
    Unknown {
        /// The given text.
        given: String,
    },
    /// A video of a scene without cameras.
    #[error("the scene has no cameras to render it from; render it along a path, such as --path swing")]
    NoCameras,
    /// The file that was written could not be read back for the comparison.
    #[error("the {} file was written but does not read back; this is a bug, please report it: {source}", format.name())]
    ReadBack {
        /// The format.
        format: Format,
        /// The reason.
        source: Box<crate::import::ImportError>,
    },
    /// Writing a capture for another tool.
    #[error(transparent)]
    Capture(#[from] WriteCaptureAsError),
    /// Writing a file of splats.
    #[error(transparent)]
    File(#[from] WriteFileError),
}

impl ExportError {
    /// What sort of failure this is.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::NoInstant { .. } | Self::NoRate { .. } | Self::Unknown { .. } => Category::Usage,
            Self::NoCameras | Self::NeedsScene { .. } | Self::NeedsCapture { .. } => Category::BadInput,
            Self::Capture(e) => e.kind().into(),
            Self::File(e) => e.kind().into(),
            Self::ReadBack { .. } => Category::Internal,
        }
    }
}
