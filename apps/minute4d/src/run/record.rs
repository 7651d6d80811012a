//! The records: `run.json` of a run, `geometry.json` of a capture.
//!
//! A record is written when work begins and again when it ends, so that it always describes the
//! folder: [`Status::Running`] without a running process means that the process was killed.

use minute4d::geometry::GeometrySummary;
use minute4d::json::{plain_json, read_json, write_json};
use minute4d::layout::GEOMETRY_FILE;
use minute4d::{Error, Progress, Settings, hash};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// Name of a run's record.
pub const RUN_FILE: &str = "run.json";
/// `format` of a run's record.
pub const RUN_FORMAT: &str = "minute4d-run";
/// `format` of a capture's record.
pub const GEOMETRY_FORMAT: &str = "minute4d-geometry";
/// Version of both; a record with another one is not used.
pub const VERSION: u32 = 1;

/// The status of a run or stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Running, or killed.
    Running,
    /// Stopped on request; can be resumed.
    Stopped,
    /// Ended in an error.
    Failed,
    /// Done, and the result was read back.
    Finished,
}

/// The input of a run.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Input {
    /// As given on the command line.
    pub path: String,
    /// BLAKE3 of its bytes, hexadecimal.
    pub blake3: String,
}

/// What a run or a stage starts from: a file or folder, and the hash that stands for it.
pub(crate) struct Source<'a> {
    /// Where it is.
    pub path: &'a Path,
    /// BLAKE3 of its bytes, or of the capture in it, hexadecimal.
    pub blake3: String,
}

impl<'a> Source<'a> {
    /// Hashes the bytes of a file or folder, but for results in `out`, which may be in it.
    pub fn read(path: &'a Path, out: Option<&Path>, watch: &dyn Progress) -> Result<Self, Error> {
        let blake3 = hash::of_input(path, out, watch)?;
        Ok(Self { path, blake3 })
    }

    /// Returns what a record says of it.
    pub fn input(&self) -> Input {
        Input {
            path: self.path.display().to_string(),
            blake3: self.blake3.clone(),
        }
    }
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
    /// Peak memory of the process up to the end of the stage, bytes; `None` if the system does not
    /// report it.
    pub peak_memory_bytes: Option<u64>,
    /// Warnings for the user about the result.
    pub warnings: Vec<String>,
}

/// The device of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Device {
    /// `"cpu"` or `"gpu"`: where training steps are taken, the last ones where a GPU failed.
    pub kind: String,
    /// The name of the GPU.
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
    /// Describes this machine and the current thread pool, with the GPU if one is used for
    /// training.
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

/// Numbers of splats of a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SplatCount {
    /// Splats without time parameters.
    pub r#static: usize,
    /// Splats with time parameters.
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

impl FileRecord {
    /// Of the file at `path`.
    pub(crate) fn of(path: &Path) -> Result<Self, Error> {
        let blake3 = hash::of_path(path)?;
        let bytes = fs::metadata(path).map_err(Error::read(path))?.len();
        Ok(Self { bytes, blake3 })
    }
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
    /// The status.
    pub status: Status,
    /// The error of a failed run.
    pub error: Option<String>,
    /// The input.
    pub input: Input,
    /// The profile that the settings are based on.
    pub profile: String,
    /// Seed of every random number.
    pub seed: u64,
    /// Every setting in effect.
    pub settings: Value,
    /// The device.
    pub device: Device,
    /// `bitwise`: the same input, settings, seed, SIMD level and GPU give the same bits on any
    /// number of threads.
    pub determinism: String,
    /// By name: `geometry`, `train`, `preview`, `viewer`.
    pub stages: BTreeMap<String, StageRecord>,
    /// Wall-clock seconds of all stages.
    pub seconds: f64,
    /// Peak memory of the process in any stage, bytes; `None` if the system does not report it.
    pub peak_memory_bytes: Option<u64>,
    /// Iterations of training that are done.
    pub iterations: Option<usize>,
    /// Splats of the scene.
    pub splats: Option<SplatCount>,
    /// Files of the result by name.
    pub files: BTreeMap<String, FileRecord>,
    /// Warnings for the user.
    pub warnings: Vec<String>,
}

impl RunRecord {
    /// Creates the record of a starting run.
    ///
    /// # Errors
    ///
    /// [`Error::Internal`] if the settings cannot be serialised.
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

    /// Writes the record into the folder of the run, atomically.
    ///
    /// # Errors
    ///
    /// [`Error::Write`].
    pub fn write(&mut self, folder: &Path) -> Result<(), Error> {
        self.seconds = self.stages.values().map(|s| s.seconds).sum();
        self.warnings = self
            .stages
            .values()
            .flat_map(|s| s.warnings.iter().cloned())
            .collect();
        self.peak_memory_bytes = self
            .stages
            .values()
            .filter_map(|s| s.peak_memory_bytes)
            .max();
        write_json(&folder.join(RUN_FILE), self)
    }

    /// Reads the record of a folder; `None` if there is none that this release can use.
    ///
    /// # Errors
    ///
    /// [`Error::Read`] if there is a file that cannot be read.
    pub fn read(folder: &Path) -> Result<Option<Self>, Error> {
        Ok(read_json::<Self>(&folder.join(RUN_FILE))?
            .filter(|r| r.format == RUN_FORMAT && r.version == VERSION))
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
    /// The status.
    pub status: Status,
    /// The input.
    pub input: Input,
    /// Hash of input, settings and version.
    pub key: String,
    /// Every setting of the stage.
    pub settings: Value,
    /// The findings.
    pub found: Option<GeometrySummary>,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Peak memory of the process, bytes; `None` if the system does not report it.
    pub peak_memory_bytes: Option<u64>,
    /// Warnings for the user.
    pub warnings: Vec<String>,
}

impl GeometryRecord {
    /// Creates the record of a stage that is about to run with this key and these settings.
    pub(crate) fn begin(source: &Source<'_>, key: String, settings: Value) -> Self {
        Self {
            format: GEOMETRY_FORMAT.to_owned(),
            version: VERSION,
            minute4d: env!("CARGO_PKG_VERSION").to_owned(),
            status: Status::Running,
            input: source.input(),
            key,
            settings,
            found: None,
            seconds: 0.0,
            peak_memory_bytes: None,
            warnings: Vec::new(),
        }
    }

    /// Writes the record into the capture, atomically.
    ///
    /// # Errors
    ///
    /// [`Error::Write`].
    pub fn write(&mut self, folder: &Path) -> Result<(), Error> {
        self.peak_memory_bytes = peak_memory_bytes().max(self.peak_memory_bytes);
        write_json(&folder.join(GEOMETRY_FILE), self)
    }

    /// Reads the record of a capture; `None` if there is none that this release can use.
    ///
    /// # Errors
    ///
    /// [`Error::Read`] if there is a file that cannot be read.
    pub fn read(folder: &Path) -> Result<Option<Self>, Error> {
        let record = read_json::<Self>(&folder.join(GEOMETRY_FILE))?;
        Ok(record.filter(|r| r.format == GEOMETRY_FORMAT && r.version == VERSION))
    }
}

/// Returns the peak memory of this process so far, bytes; available on Linux only.
#[must_use]
pub fn peak_memory_bytes() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::peak_memory_bytes;

    #[test]
    fn memory_is_plausible_where_it_is_known() {
        if let Some(bytes) = peak_memory_bytes() {
            assert!((1 << 18..1 << 40).contains(&bytes), "{bytes}");
        }
    }
}
