//! Reads camera paths for rendering.
//!
//! Two layouts of JSON are read, distinguished by their keys: `transforms.json` (one camera per image: `frames[]` with
//! `transform_matrix`, `time`, `fl_x` .. `h`; see [`crate::dataset::nerfstudio`]), and keyframes between which the caller
//! interpolates ([`Keyed`], described in docs/paths.md).

mod keyed;

pub use keyed::{KeyPose, Keyed, Keyframe, SceneTime};

use crate::dataset::Distortion;
use crate::dataset::nerfstudio::{Frame, LensKeys, Transforms, lens_of};
use crate::error::AtPath;
use crate::{Fault, ReadError, files, pose};
use m4_core::{Camera, Intrinsics};
use serde::Deserialize;
use serde::de::{DeserializeOwned, IgnoredAny};
use std::path::Path;

/// Longest file that is read, bytes: half a kilobyte per camera.
const MAX_BYTES: u64 = 64 << 20;
/// Most cameras or keyframes of a path: an hour at 28 frames per second.
const MAX_CAMERAS: usize = 100_000;
/// Largest side of an image to render, pixels.
const MAX_SIDE_PX: f64 = 16_384.0;
const HINT: &str = "give a nerfstudio transforms.json, or keyframes as docs/paths.md describes them";

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

/// What is wrong with a path: with the camera or keyframe of an index, or with the whole.
struct BadPath(Option<usize>, String);

impl From<String> for BadPath {
    fn from(what: String) -> Self {
        Self(None, what)
    }
}

impl From<(usize, String)> for BadPath {
    fn from((camera, what): (usize, String)) -> Self {
        Self(Some(camera), what)
    }
}

/// Reads a camera path; moments that the file gives as a share of the scene (0..1) become frames
/// 0..=`time_frames - 1`. A list without any times runs evenly through the whole scene.
///
/// # Errors
///
/// [`ReadError`], which names the file and the camera at fault.
pub fn load(path: &Path, time_frames: usize) -> Result<Trajectory, ReadError> {
    let bytes = files::bytes(path, MAX_BYTES).at(path)?;
    of_bytes(&bytes, time_frames).map_err(|BadPath(camera, what)| match camera {
        Some(camera) => Fault::bad(what, "correct it").within(path, format!("camera {camera}")),
        None => Fault::bad(format!("it is not a camera path: {what}"), HINT).at(path),
    })
}

/// The cameras of a file that lists them, each with its moment in frames; as [`load`].
///
/// # Errors
///
/// [`ReadError`], also where the file holds keyframes.
pub fn read(path: &Path, time_frames: usize) -> Result<Vec<(Camera, f64)>, ReadError> {
    match load(path, time_frames)? {
        Trajectory::Listed(cameras) => Ok(cameras),
        Trajectory::Keyed(_) => Err(Fault::bad("it holds keyframes", "give a list of cameras").at(path)),
    }
}

fn of_bytes(bytes: &[u8], time_frames: usize) -> Result<Trajectory, BadPath> {
    let last_frame = (time_frames.max(1) - 1) as f64;
    let probe: Probe = json(bytes)?;
    let count = probe.frames.len().max(probe.keyframes.len());
    let format = keyed::FORMAT;
    if count > MAX_CAMERAS {
        return Err(format!("it has {count} cameras, more than the {MAX_CAMERAS} that are rendered").into());
    }
    match probe.format {
        Some(own) if own == format => Ok(Trajectory::Keyed(keyed::keyed(&json(bytes)?)?)),
        Some(other) => Err(format!("its format is {other:?}, not {format:?}").into()),
        None if !probe.frames.is_empty() => Ok(Trajectory::Listed(listed(json(bytes)?, last_frame)?)),
        None if !probe.keyframes.is_empty() => {
            Err(format!("it has keyframes, but \"format\": {format:?} is missing").into())
        }
        None => Err("it has no frames or keyframes".to_owned().into()),
    }
}

fn json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, BadPath> {
    serde_json::from_slice(bytes).map_err(|e| e.to_string().into())
}

/// The cameras of a `transforms.json` with the moment of each: `time` (0..1) of the file times `last_frame`.
fn listed(file: Transforms, last_frame: f64) -> Result<Vec<(Camera, f64)>, BadPath> {
    let mut frames = Vec::with_capacity(file.frames.len());
    for (i, value) in file.frames.into_iter().enumerate() {
        let frame: Frame = serde_json::from_value(value).map_err(|e| (i, e.to_string()))?;
        frames.push(frame);
    }
    let timed = frames.iter().filter(|f| f.time.is_some()).count();
    let camera = |(i, frame): (usize, &Frame)| -> Result<(Camera, f64), String> {
        let time = match frame.time {
            Some(time) => time,
            None if timed == 0 => i as f64 / (frames.len().max(2) - 1) as f64,
            None => return Err(format!("time is missing, but {timed} other cameras have one")),
        };
        if !(0.0..=1.0).contains(&time) {
            return Err(format!("time = {time}; 0 to 1 was expected"));
        }
        let rows = frame.transform_matrix.as_ref().ok_or("transform_matrix is missing")?;
        let pose = pose::of_rows("transform_matrix", rows).map_err(|e| e.to_string())?;
        let camera =
            Camera { intrinsics: intrinsics(frame, &file.lens)?, c2w: file.axes.unwrap_or_default().to_opencv(&pose) };
        Ok((camera, time * last_frame))
    };
    let all = frames.iter().enumerate();
    all.map(|(i, frame)| camera((i, frame)).map_err(|what| (i, what).into())).collect()
}

fn intrinsics(frame: &Frame, all: &LensKeys) -> Result<Intrinsics, String> {
    let keys = frame.lens.or(all);
    let pixels = |key: &str, value: Option<f64>| {
        let value = value.ok_or_else(|| format!("{key}, the size of the image in pixels, is missing"))?;
        side(key, value)
    };
    let size = (pixels("w", keys.w)?, pixels("h", keys.h)?);
    let lens = lens_of(&keys, size).map_err(|e| e.to_string())?;
    if lens.distortion != Distortion::None {
        return Err("the lens has distortion; only cameras without distortion are rendered".into());
    }
    Ok(lens.intrinsics)
}

/// A number of pixels.
fn side(key: &str, value: f64) -> Result<usize, String> {
    if value.fract() == 0.0 && (1.0..=MAX_SIDE_PX).contains(&value) {
        Ok(value as usize)
    } else {
        Err(format!("{key} = {value}; 1 to {MAX_SIDE_PX} pixels were expected"))
    }
}
