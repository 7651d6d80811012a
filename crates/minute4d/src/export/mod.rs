//! Exports a scene for other tools, and reports bytes, seconds and losses.
//!
//! Adding a format: a variant of [`Format`] with its row in the table, an arm in `write.rs`, and,
//! where there is a reader, one in the program's `run::import`.

mod bake;
mod report;
mod unbind;
mod write;

pub use report::{ExportReport, Losses};

use crate::error::OutputError;
use crate::layout::is_capture;
use crate::layout::{self, SCENE_FILE};
use crate::render::{Moment, Span};
use crate::{Error, Observer, Refusal};
use m4_core::Scene;
use m4_io::results;
use m4_io::scene::safetensors;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::str::FromStr;
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
    /// Which files a capture may name.
    pub reach: m4_io::reach::Reach,
}

impl ExportJob {
    /// The format as it is by itself.
    pub fn new(format: Format) -> Self {
        Self {
            format,
            out: None,
            time: None,
            fps: None,
            replace: false,
            reach: m4_io::reach::Reach::Inside,
        }
    }
}

/// Exports `scene` to `out`, in the format of `job`, whose path is not read.
///
/// # Errors
///
/// [`Error`]: the moment lies outside the scene, options and format do not go together, or the file exists or cannot be written.
pub fn scene(
    scene: &Scene,
    out: &Path,
    job: &ExportJob,
    observer: &dyn Observer,
) -> Result<ExportReport, Error> {
    job.check()?;
    if job.format.takes_capture() {
        return Err(write::needs_capture(job.format).into());
    }
    check_free(out, job)?;
    scene_as(scene, out, job, observer)
}

/// Exports a scene (a file, or the folder of a run) or, in a format of captures, a capture.
///
/// # Errors
///
/// [`Error`]: the scene cannot be read, the moment lies outside it, options and format do not go together,
/// or the file cannot be written.
pub fn make(input: &Path, job: &ExportJob, observer: &dyn Observer) -> Result<ExportReport, Error> {
    job.check()?;
    let (takes_capture, is_capture) = (job.format.takes_capture(), is_capture(input));
    if takes_capture && !is_capture {
        return Err(write::needs_capture(job.format).into());
    }
    if !takes_capture && is_capture && !input.join(SCENE_FILE).is_file() {
        return Err(Refusal::bad_input(format!(
            "{} is a capture, which the format {} cannot store; choose colmap, or train it first",
            input.display(),
            job.format.name()
        ))
        .into());
    }
    let (home, file) = if input.is_dir() {
        (input.to_path_buf(), input.join(SCENE_FILE))
    } else {
        let home = input.parent().unwrap_or(Path::new("")).to_path_buf();
        (home, input.to_path_buf())
    };
    let out = match &job.out {
        Some(out) => out.clone(),
        None => home.join(job.format.file_name()),
    };
    check_free(&out, job)?;
    if takes_capture {
        return write::make_capture(input, out, job, observer);
    }
    if job.format.time() != Time::Sequence {
        results::check_target(&out, &[&file])?;
    }
    layout::settle(&home)?;
    let scene = safetensors::read(&file)?.scene;
    scene_as(&scene, &out, job, observer)
}

/// Exports `scene` to `out`, which is replaced.
fn scene_as(
    scene: &Scene,
    out: &Path,
    job: &ExportJob,
    observer: &dyn Observer,
) -> Result<ExportReport, Error> {
    let moments = job.moments(scene)?;
    let start = Instant::now();
    let (plain, loss) = bake::bake(scene).unzip();
    let plain = plain.as_ref().unwrap_or(scene);
    let (free, of_motion) =
        unbind::unbind(plain, job.format, moments.first().copied().unwrap_or(0.0)).unzip();
    let mut written = write::write(free.as_ref().unwrap_or(plain), out, &moments, job, observer)?;
    written
        .losses
        .splice(0..0, of_motion.into_iter().chain(loss));
    drop(free);
    let encode_s = start.elapsed().as_secs_f64();
    Ok(ExportReport::new(
        scene, job.format, &moments, written, encode_s,
    ))
}

impl ExportJob {
    fn check(&self) -> Result<(), Refusal> {
        let time = self.format.time();
        if self.time.is_some() && time != Time::Instant {
            return Err(Refusal::usage(format!(
                "a time has no meaning for {}, which holds the whole clip; leave it out, or choose a format of one instant such as ply",
                self.format.name()
            )));
        }
        if self.fps.is_some() && time != Time::Sequence {
            return Err(Refusal::usage(format!(
                "a rate (fps) has no meaning for {}; leave it out, or choose ply-sequence",
                self.format.name()
            )));
        }
        Ok(())
    }

    /// The moments that are written, frames: one, or those of a sequence; none for a format with
    /// time.
    fn moments(&self, scene: &Scene) -> Result<Vec<f64>, Error> {
        let last = scene.time_frames.saturating_sub(1) as f64;
        match self.format.time() {
            Time::Instant => Ok(vec![match self.time {
                Some(moment) => Span::of(scene).frames(moment)?,
                None => (last / 2.0).round(),
            }]),
            Time::Sequence => {
                // as many frames of the scene from one file to the next
                let step = self
                    .fps
                    .map_or(1.0, |fps| crate::render::source_fps(scene) / fps);
                let count = (last / step + 1e-9).floor() as usize + 1;
                Ok((0..count).map(|i| (i as f64 * step).min(last)).collect())
            }
            Time::Clip | Time::Capture => Ok(Vec::new()),
        }
    }
}

/// Refuses a file, and a folder with something in it, that may not be replaced.
fn check_free(path: &Path, job: &ExportJob) -> Result<(), OutputError> {
    let is_occupied = match std::fs::read_dir(path) {
        Ok(mut entries) => entries.next().is_some(),
        Err(_) => path.exists(),
    };
    match is_occupied && !job.replace {
        true => Err(OutputError::would_replace(path)),
        false => Ok(()),
    }
}

/// A format that other tools read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Format {
    /// `.4dgs`: splats with time.
    #[serde(rename = "4dgs")]
    Fourdgs,
    /// One PLY file of 3DGS.
    Ply,
    /// A folder with one PLY file a frame.
    PlySequence,
    /// `.ftgs.ply`: splats with time, of players of FreeTimeGS.
    Ftgs,
    /// `.splatv`: splats with time, of the splaTV player.
    Splatv,
    /// SPZ, one instant.
    Spz,
    /// Binary glTF with `KHR_gaussian_splatting`, one instant.
    Gltf,
    /// Of a capture: a COLMAP model with images, masks and points of static regions.
    Colmap,
}

/// What a format does with time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Time {
    /// It holds all of it.
    Clip,
    /// It holds one instant.
    Instant,
    /// It holds one instant a frame.
    Sequence,
    /// It holds a capture, no splats.
    Capture,
}

/// A row of the table: format, name, usual name of the file, time.
type Entry = (Format, &'static str, &'static str, Time);

const FORMATS: &[Entry] = &[
    (Format::Fourdgs, "4dgs", "scene.4dgs", Time::Clip),
    (Format::Ply, "ply", "scene.ply", Time::Instant),
    (Format::PlySequence, "ply-sequence", "ply", Time::Sequence),
    (Format::Ftgs, "ftgs", "scene.ftgs.ply", Time::Clip),
    (Format::Splatv, "splatv", "scene.splatv", Time::Clip),
    (Format::Spz, "spz", "scene.spz", Time::Instant),
    (Format::Gltf, "gltf", "scene.glb", Time::Instant),
    (Format::Colmap, "colmap", "colmap", Time::Capture),
];

impl Format {
    /// Every format.
    pub fn all() -> impl Iterator<Item = Self> {
        FORMATS.iter().map(|entry| entry.0)
    }

    fn entry(self) -> &'static Entry {
        // Every variant has a row: see the test.
        FORMATS
            .iter()
            .find(|entry| entry.0 == self)
            .unwrap_or(&FORMATS[0])
    }

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        self.entry().1
    }

    /// The usual name of its file or folder.
    pub fn file_name(self) -> &'static str {
        self.entry().2
    }

    /// Whether it holds captures.
    pub fn takes_capture(self) -> bool {
        self.time() == Time::Capture
    }

    /// What it does with time.
    pub fn time(self) -> Time {
        self.entry().3
    }

    /// The names of all formats.
    pub fn names() -> String {
        let names: Vec<&str> = FORMATS.iter().map(|entry| entry.1).collect();
        names.join(", ")
    }

    /// The format that the ending of a file name stands for.
    pub fn of_path(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?.to_ascii_lowercase();
        if name.ends_with(".ftgs.ply") {
            return Some(Self::Ftgs);
        }
        let ending = path.extension()?.to_str()?.to_ascii_lowercase();
        let same = |entry: &&Entry| {
            Path::new(entry.2)
                .extension()
                .is_some_and(|e| e == ending.as_str())
        };
        FORMATS.iter().find(same).map(|entry| entry.0)
    }
}

impl FromStr for Format {
    type Err = Refusal;

    fn from_str(text: &str) -> Result<Self, Refusal> {
        let row = FORMATS.iter().find(|entry| entry.1 == text);
        row.map(|entry| entry.0).ok_or_else(|| {
            let names = Self::names();
            Refusal::usage(format!("{text:?} is not a format; choose one of {names}"))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{FORMATS, Format};
    use std::path::Path;

    #[test]
    fn every_format_has_a_row_of_its_own() {
        for format in Format::all() {
            assert_eq!(format.entry().0, format);
            assert_eq!(format.name().parse::<Format>().unwrap(), format);
            assert_eq!(FORMATS.iter().filter(|e| e.1 == format.name()).count(), 1);
            let json = serde_json::to_value(format).unwrap();
            assert_eq!(json, format.name());
        }
        assert!(
            "obj"
                .parse::<Format>()
                .unwrap_err()
                .to_string()
                .contains("4dgs, ply,")
        );
    }

    #[test]
    fn endings_name_formats() {
        assert_eq!(
            Format::of_path(Path::new("a/b.4DGS")),
            Some(Format::Fourdgs)
        );
        assert_eq!(Format::of_path(Path::new("b.ply")), Some(Format::Ply));
        assert_eq!(
            Format::of_path(Path::new("a/scene.FTGS.ply")),
            Some(Format::Ftgs)
        );
        assert_eq!(Format::of_path(Path::new("ply")), None);
        assert_eq!(Format::of_path(Path::new("dog_droid.npz")), None);
    }
}
