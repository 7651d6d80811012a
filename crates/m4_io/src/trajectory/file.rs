//! A camera path file of any layout.

use super::{Keyed, ReadTrajectoryError, keyed, listed, own};
use m4_core::Camera;
use serde::Deserialize;
use serde::de::{DeserializeOwned, IgnoredAny};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Longest file that is read, bytes: half a kilobyte per camera.
const MAX_BYTES: u64 = 64 << 20;
/// Most cameras or keyframes of a path: an hour at 28 frames per second.
const MAX_CAMERAS: usize = 100_000;

/// The contents of a camera path file.
#[derive(Debug, Clone, PartialEq)]
pub enum Trajectory {
    /// One camera per image, each with its moment in frames.
    Listed(Vec<(Camera, f64)>),
    /// Keyframes.
    Keyed(Keyed),
}

/// The keys that distinguish the layouts.
#[derive(Deserialize)]
struct Probe {
    format: Option<String>,
    #[serde(default)]
    frames: Vec<IgnoredAny>,
    #[serde(default)]
    keyframes: Vec<IgnoredAny>,
}

/// Why the bytes are no camera path; the caller knows the file.
pub enum BadPath {
    /// The whole file.
    File(String),
    /// A camera or keyframe, by its index.
    Camera(usize, String),
}

impl From<String> for BadPath {
    fn from(reason: String) -> Self {
        Self::File(reason)
    }
}

impl From<(usize, String)> for BadPath {
    fn from((camera, what): (usize, String)) -> Self {
        Self::Camera(camera, what)
    }
}

/// Reads a camera path; moments that the file gives as a share of the scene (0..1) become frames
/// 0..=`time_frames - 1`. A list without any times runs evenly through the whole scene.
///
/// # Errors
///
/// [`ReadTrajectoryError`], which names the file and the camera at fault.
pub fn load(path: &Path, time_frames: usize) -> Result<Trajectory, ReadTrajectoryError> {
    let bytes = bytes(path)?;
    of_bytes(&bytes, time_frames).map_err(|cause| {
        let path = path.to_path_buf();
        match cause {
            BadPath::File(reason) => ReadTrajectoryError::Json { path, reason },
            BadPath::Camera(camera, what) => ReadTrajectoryError::BadCamera { path, camera, what },
        }
    })
}

/// The cameras of a file that lists them, each with its moment in frames; as [`load`].
///
/// # Errors
///
/// [`ReadTrajectoryError`], also where the file holds keyframes.
pub fn read(path: &Path, time_frames: usize) -> Result<Vec<(Camera, f64)>, ReadTrajectoryError> {
    match load(path, time_frames)? {
        Trajectory::Listed(cameras) => Ok(cameras),
        Trajectory::Keyed(_) => Err(ReadTrajectoryError::Json {
            path: path.to_path_buf(),
            reason: "it holds keyframes where a list of cameras was expected".to_owned(),
        }),
    }
}

fn of_bytes(bytes: &[u8], time_frames: usize) -> Result<Trajectory, BadPath> {
    let last_frame = (time_frames.max(1) - 1) as f64;
    let probe: Probe = json(bytes)?;
    let count = probe.frames.len().max(probe.keyframes.len());
    if count > MAX_CAMERAS {
        return Err(BadPath::File(format!(
            "it has {count} cameras, more than the {MAX_CAMERAS} that are rendered"
        )));
    }
    match &probe.format {
        Some(format) if format == own::FORMAT => {
            let keyed = own::keyed(json(bytes)?)?;
            keyed::check_order(&keyed.keyframes)?;
            Ok(Trajectory::Keyed(keyed))
        }
        Some(format) => Err(BadPath::File(format!(
            "its format is {format:?}, not {:?}",
            own::FORMAT
        ))),
        None if !probe.frames.is_empty() => Ok(Trajectory::Listed(listed::listed(json(bytes)?, last_frame)?)),
        None if !probe.keyframes.is_empty() => Err(BadPath::File(format!(
            "it has keyframes, but \"format\": {:?} is missing",
            own::FORMAT
        ))),
        None => Err(BadPath::File("it has no frames or keyframes".to_owned())),
    }
}

fn json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, BadPath> {
    serde_json::from_slice(bytes).map_err(|e| BadPath::File(e.to_string()))
}

fn bytes(path: &Path) -> Result<Vec<u8>, ReadTrajectoryError> {
    let io = |source| ReadTrajectoryError::Io {
        path: path.to_path_buf(),
        source,
    };
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(io)?;
    file.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(io)?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(ReadTrajectoryError::Json {
            path: path.to_path_buf(),
            reason: "it is larger than 64 MiB".to_owned(),
        });
    }
    Ok(bytes)
}
