//! What was done: `run.json` of a run, `geometry.json` of a capture.
//!
//! A record is written when work begins and again when it ends, so that a folder always says what is
//! in it: [`Status::Running`] without a running process means that the process was killed.

use crate::geometry::{Confidence, UsedNetwork};
use crate::{Error, Settings};
use m4_io::atomic;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;

/// Name of a run's record.
pub const RUN_FILE: &str = "run.json";
/// Name of the record that the geometry stage leaves in a capture.
pub const GEOMETRY_FILE: &str = "geometry.json";
/// `format` of a run's record.
pub const RUN_FORMAT: &str = "minute4d-run";
/// `format` of a capture's record.
pub const GEOMETRY_FORMAT: &str = "minute4d-geometry";
/// Version of both; a record with another one is not used.
pub const VERSION: u32 = 1;

/// How far the work is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// At work, or killed.
    Running,
    /// Stopped on request; can be resumed.
    Stopped,
    /// Ended in an error.
    Failed,
    /// Done, and the result was read back.
    Finished,
}

/// Where the data came from.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Input {
    /// As given on the command line.
    pub path: String,
    /// BLAKE3 of its bytes, hexadecimal.
    pub blake3: String,
}

/// One stage of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageRecord {
    /// Hash of the stage's input, settings and version: with the same key the result is the same.
    pub key: String,
    /// True when its result is complete.
    pub done: bool,
    /// Wall-clock seconds, those before an interruption included.
    pub seconds: f64,
    /// Most memory that the process held up to the end of the stage, bytes; only where the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// What the user should know about its result.
    pub warnings: Vec<String>,
}

/// What it was computed on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Device {
    /// `"cpu"` or `"gpu"`: where training steps are taken.
    pub kind: String,
    /// What the GPU is called.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gpu: Option<String>,
    /// Vector instructions used, as `minute4d doctor` names them.
    pub simd: String,
    /// Threads used; the result does not depend on them.
    pub threads: usize,
    /// Architecture and system, such as `x86_64-linux`.
    pub platform: String,
}

impl Device {
    /// This machine, and the current pool of threads; the GPU that trains, if one does.
    #[must_use]
    pub fn here(simd: m4_kernels::SimdLevel, gpu: Option<&str>) -> Self {
        Self {
            kind: gpu.map_or("cpu", |_| "gpu").to_owned(),
            gpu: gpu.map(str::to_owned),
            simd: simd.name().to_owned(),
            threads: rayon::current_num_threads(),
            platform: format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS),
        }
    }
}

/// How many splats a scene has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SplatCount {
    /// Without time parameters.
    pub r#static: usize,
    /// With them.
    pub dynamic: usize,
}

/// One file of the result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRecord {
    /// Size.
    pub bytes: u64,
    /// BLAKE3 of its bytes, hexadecimal.
    pub blake3: String,
}

/// `run.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// [`RUN_FORMAT`].
    pub format: String,
    /// [`VERSION`].
    pub version: u32,
    /// Release of the program that wrote it.
    pub minute4d: String,
    /// How far it got.
    pub status: Status,
    /// The error of a failed run.
    pub error: Option<String>,
    /// What was read.
    pub input: Input,
    /// Built-in settings that it started from.
    pub profile: String,
    /// Seed of every random number.
    pub seed: u64,
    /// Every setting in effect.
    pub settings: Value,
    /// What it ran on.
    pub device: Device,
    /// `bitwise`: the same input, settings, seed, SIMD level and GPU give the same bits on any number of
    /// threads.
    pub determinism: String,
    /// By name: `geometry`, `train`, `preview`, `viewer`.
    pub stages: BTreeMap<String, StageRecord>,
    /// Wall-clock seconds of all stages.
    pub seconds: f64,
    /// Most memory that the process held in any stage, bytes; only where the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// Iterations of training that are done.
    pub iterations: Option<usize>,
    /// Splats of the scene.
    pub splats: Option<SplatCount>,
    /// Files of the result by name.
    pub files: BTreeMap<String, FileRecord>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

impl RunRecord {
    /// The record of a run that begins.
    ///
    /// # Errors
    ///
    /// [`Error::Internal`] if the settings cannot be written down.
    pub fn begin(input: Input, settings: &Settings, device: Device) -> Result<Self, Error> {
        Ok(Self {
            format: RUN_FORMAT.to_owned(),
            version: VERSION,
            minute4d: env!("CARGO_PKG_VERSION").to_owned(),
            status: Status::Running,
            error: None,
            input,
            profile: settings.profile.name().to_owned(),
            seed: settings.train.seed,
            settings: plain_json(settings)?,
            device,
            determinism: "bitwise".to_owned(),
            stages: BTreeMap::new(),
            seconds: 0.0,
            peak_memory_bytes: None,
            iterations: None,
            splats: None,
            files: BTreeMap::new(),
            warnings: Vec::new(),
        })
    }

    /// Writes it into the folder of the run, whole or not at all.
    ///
    /// # Errors
    ///
    /// [`Error::Write`].
    pub fn write(&mut self, folder: &Path) -> Result<(), Error> {
        self.seconds = self.stages.values().map(|s| s.seconds).sum();
        self.warnings = self.stages.values().flat_map(|s| s.warnings.iter().cloned()).collect();
        self.peak_memory_bytes = self.stages.values().filter_map(|s| s.peak_memory_bytes).max();
        write_json(&folder.join(RUN_FILE), self)
    }

    /// The record of a folder; `None` if it has none that this release can use.
    ///
    /// # Errors
    ///
    /// [`Error::Read`] if there is a file that cannot be read.
    pub fn read(folder: &Path) -> Result<Option<Self>, Error> {
        Ok(read_json::<Self>(&folder.join(RUN_FILE))?.filter(|r| r.format == RUN_FORMAT && r.version == VERSION))
    }
}

/// `geometry.json`: how a capture was made from a video.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GeometryRecord {
    /// [`GEOMETRY_FORMAT`].
    pub format: String,
    /// [`VERSION`].
    pub version: u32,
    /// Release of the program that wrote it.
    pub minute4d: String,
    /// How far it got.
    pub status: Status,
    /// What was read.
    pub input: Input,
    /// Hash of input, settings and version.
    pub key: String,
    /// Every setting of the stage.
    pub settings: Value,
    /// What was found.
    pub found: Option<Found>,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Most memory that the process held, bytes; only where the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// What the geometry stage found in a video.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// Frames of the capture.
    pub frames: usize,
    /// Their size, pixels.
    pub size: [usize; 2],
    /// Horizontal focal length, pixels.
    pub focal_px: f64,
    /// The same as a field of view, degrees.
    pub fov_deg: f64,
    /// `parallax`, `rotation_only` or `static`.
    pub camera_motion: String,
    /// Median reprojection error of what stands still, pixels.
    pub residual_px: f64,
    /// Tracks followed.
    pub tracks: usize,
    /// Tracks with a place in the world.
    pub points: usize,
    /// Share of all pixels that count as moving.
    pub moving_share: f64,
    /// Points of what moves that were followed, in `tracks.npz`.
    #[serde(default)]
    pub moving_tracks: usize,
    /// Who found cameras, measured flow and knew depth: `classical`, `raft`, `megasam+raft+moge`.
    #[serde(default)]
    pub frontend: String,
    /// The networks of it, with the licences of their weights.
    #[serde(default)]
    pub networks: Vec<UsedNetwork>,
    /// Frames that were keyframes of the tracking network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub keyframes: Option<Vec<usize>>,
    /// Units of MegaSaM's own files (disparities whose 98th percentile is 2) a metre, where depth is metric.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub megasam_units_a_metre: Option<f64>,
    /// Who outlined what moves: `none`, `mobilesam`.
    #[serde(default)]
    pub segmenter: String,
    /// What the user gave: `intrinsics`, `poses`, `masks`, `depth`.
    #[serde(default)]
    pub given: Vec<String>,
    /// How often depth and masks were made: twice where masks changed the cameras.
    #[serde(default = "once")]
    pub rounds: usize,
    /// How far it can be trusted.
    #[serde(default)]
    pub confidence: Option<Confidence>,
}

/// What records of earlier releases mean.
fn once() -> usize {
    1
}

impl GeometryRecord {
    /// Writes it into the capture, whole or not at all.
    ///
    /// # Errors
    ///
    /// [`Error::Write`].
    pub fn write(&mut self, folder: &Path) -> Result<(), Error> {
        self.peak_memory_bytes = peak_memory_bytes().max(self.peak_memory_bytes);
        write_json(&folder.join(GEOMETRY_FILE), self)
    }

    /// The record of a capture; `None` if it has none that this release can use.
    ///
    /// # Errors
    ///
    /// [`Error::Read`] if there is a file that cannot be read.
    pub fn read(folder: &Path) -> Result<Option<Self>, Error> {
        let record = read_json::<Self>(&folder.join(GEOMETRY_FILE))?;
        Ok(record.filter(|r| r.format == GEOMETRY_FORMAT && r.version == VERSION))
    }
}

/// A value as JSON in which 32-bit numbers keep their short form.
///
/// # Errors
///
/// [`Error::Internal`] if the value cannot be written as JSON.
pub fn plain_json(value: &impl Serialize) -> Result<Value, Error> {
    let internal = |e: serde_json::Error| Error::Internal { what: e.to_string() };
    // Through text: `to_value` would widen 0.1f32 to 0.10000000149011612.
    serde_json::from_str(&serde_json::to_string(value).map_err(internal)?).map_err(internal)
}

/// A value as indented JSON, keys in the order of its fields.
///
/// # Errors
///
/// [`Error::Internal`] if the value cannot be written as JSON.
pub fn pretty_json(value: &impl Serialize) -> Result<String, Error> {
    let text = serde_json::to_string_pretty(value).map_err(|e| Error::Internal { what: e.to_string() })?;
    Ok(text + "\n")
}

/// Writes `value` as indented JSON, whole or not at all.
pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), Error> {
    let text = pretty_json(value)?;
    atomic::write(path, text.as_bytes()).map_err(|source| Error::Write {
        path: path.to_path_buf(),
        source,
    })
}

/// Reads JSON; `None` where there is no file or it holds something else.
fn read_json<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, Error> {
    match fs::read(path) {
        Ok(bytes) => Ok(serde_json::from_slice(&bytes).ok()),
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(None),
        Err(source) => Err(Error::Read {
            path: path.to_path_buf(),
            source,
        }),
    }
}

/// The most memory this process has held so far, bytes; known on Linux alone.
#[must_use]
pub fn peak_memory_bytes() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::{peak_memory_bytes, plain_json};

    #[test]
    fn short_numbers_stay_short() {
        assert_eq!(plain_json(&0.1f32).unwrap().to_string(), "0.1");
    }

    #[test]
    fn memory_is_plausible_where_it_is_known() {
        if let Some(bytes) = peak_memory_bytes() {
            assert!((1 << 18..1 << 40).contains(&bytes), "{bytes}");
        }
    }
}
