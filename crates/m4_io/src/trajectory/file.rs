//! A camera path file of any layout.

use super::{Keyed, ReadTrajectoryError, keyed, listed, nerfstudio, own};
use m4_core::Camera;
use serde::Deserialize;
use serde::de::{DeserializeOwned, IgnoredAny};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Longest file that is read, bytes: half a kilobyte a camera.
const MAX_BYTES: u64 = 64 << 20;
/// Most cameras or keyframes of a path: an hour at 28 frames per second.
const MAX_CAMERAS: usize = 100_000;

/// What a file says about a camera path.
#[derive(Debug, Clone, PartialEq)]
pub enum Trajectory {
    /// A camera an image.
    Listed(Listed),
    /// Places to go through.
    Keyed(Keyed),
}

/// A camera path as a camera an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Listed {
    /// Cameras, each with its moment in frames.
    pub cameras: Vec<(Camera, f64)>,
    /// Frames a second, where the file says.
    pub fps: Option<f64>,
    /// What of the file has no effect, for people.
    pub remarks: Vec<String>,
}

/// What tells the layouts apart.
#[derive(Deserialize)]
struct Probe {
    format: Option<String>,
    #[serde(default)]
    frames: Vec<IgnoredAny>,
    #[serde(default)]
    camera_path: Vec<IgnoredAny>,
    #[serde(default)]
    keyframes: Vec<ProbeKey>,
}

#[derive(Deserialize)]
struct ProbeKey {
    matrix: Option<IgnoredAny>,
    time_s: Option<IgnoredAny>,
}

/// Why the bytes are no camera path; the caller knows the file.
pub enum Fault {
    /// The whole file.
    File(String),
    /// A camera or keyframe, by its index.
    Camera(usize, String),
}

impl From<String> for Fault {
    fn from(reason: String) -> Self {
        Self::File(reason)
    }
}

impl From<(usize, String)> for Fault {
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
    of_bytes(&bytes, time_frames).map_err(|fault| {
        let path = path.to_path_buf();
        match fault {
            Fault::File(reason) => ReadTrajectoryError::Json { path, reason },
            Fault::Camera(camera, what) => ReadTrajectoryError::BadCamera { path, camera, what },
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
        Trajectory::Listed(listed) => Ok(listed.cameras),
        Trajectory::Keyed(_) => Err(ReadTrajectoryError::Json {
            path: path.to_path_buf(),
            reason: "it holds keyframes where a list of cameras was expected".to_owned(),
        }),
    }
}

fn of_bytes(bytes: &[u8], time_frames: usize) -> Result<Trajectory, Fault> {
    let last_frame = (time_frames.max(1) - 1) as f64;
    let probe: Probe = json(bytes)?;
    let count = probe
        .frames
        .len()
        .max(probe.camera_path.len())
        .max(probe.keyframes.len());
    if count > MAX_CAMERAS {
        return Err(Fault::File(format!(
            "it has {count} cameras, more than the {MAX_CAMERAS} that are rendered"
        )));
    }
    if let Some(format) = &probe.format {
        if format != own::FORMAT {
            return Err(Fault::File(format!("its format is {format:?}, not {:?}", own::FORMAT)));
        }
        return checked(own::keyed(json(bytes)?)?);
    }
    if !probe.frames.is_empty() || !probe.camera_path.is_empty() {
        return Ok(Trajectory::Listed(listed::listed(&json(bytes)?, last_frame)?));
    }
    match probe.keyframes.first() {
        Some(ProbeKey { matrix: Some(_), .. }) => checked(nerfstudio::keyed(&json(bytes)?, last_frame)?),
        Some(ProbeKey { time_s: Some(_), .. }) => Err(Fault::File(format!(
            "its keyframes have time_s, but \"format\": {:?} is missing",
            own::FORMAT
        ))),
        Some(_) => Err(Fault::File(
            "its first keyframe has neither a matrix (nerfstudio) nor time_s".to_owned(),
        )),
        None => Err(Fault::File("it has no frames, camera_path or keyframes".to_owned())),
    }
}

fn checked(keyed: Keyed) -> Result<Trajectory, Fault> {
    keyed::check_order(&keyed.keyframes)?;
    Ok(Trajectory::Keyed(keyed))
}

fn json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Fault> {
    serde_json::from_slice(bytes).map_err(|e| Fault::File(e.to_string()))
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
