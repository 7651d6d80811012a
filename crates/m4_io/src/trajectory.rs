//! Reads camera paths for rendering.
//!
//! Two layouts of JSON are read, distinguished by their keys: `transforms.json` (one camera per
//! image: `frames[]` with `transform_matrix`, `time`, `fl_x` .. `h`; see
//! [`crate::dataset::nerfstudio`]), and keyframes between which the caller interpolates ([`Keyed`],
//! described in docs/paths.md).

use crate::dataset::Distortion;
use crate::dataset::nerfstudio::{Frame, LensKeys, Transforms, lens_of};
use crate::error::AtPath;
use crate::pose::{self, Axes};
use crate::range::{self, Range};
use crate::{Fault, ReadError, files};
use m4_core::nalgebra::Vector3;
use m4_core::{Camera, Intrinsics, Se3};
use serde::Deserialize;
use serde::de::{DeserializeOwned, IgnoredAny};
use std::path::Path;

/// Longest file that is read, bytes: half a kilobyte per camera.
const MAX_BYTES: u64 = 64 << 20;
/// Most cameras or keyframes of a path: an hour at 28 frames per second.
const MAX_CAMERAS: usize = 100_000;
/// Largest side of an image to render, pixels.
const MAX_SIDE_PX: f64 = 16_384.0;
const HINT: &str =
    "give a nerfstudio transforms.json, or keyframes as docs/paths.md describes them";

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
type BadPath = (Option<usize>, String);

/// Reads a camera path; moments that the file gives as a share of the scene (0..1) become frames
/// 0..=`time_frames - 1`. A list without any times runs evenly through the whole scene.
pub fn load(path: &Path, time_frames: usize) -> Result<Trajectory, ReadError> {
    let bytes = files::read(path, MAX_BYTES).at(path)?;
    of_bytes(files::without_mark(&bytes), time_frames).map_err(|(camera, what)| match camera {
        Some(camera) => Fault::bad(what, "correct it").within(path, format!("camera {camera}")),
        None => Fault::bad(format!("it is not a camera path: {what}"), HINT).at(path),
    })
}

/// The cameras of a file that lists them (not of keyframes), each with its moment in frames; as
/// [`load`].
pub fn read(path: &Path, time_frames: usize) -> Result<Vec<(Camera, f64)>, ReadError> {
    match load(path, time_frames)? {
        Trajectory::Listed(cameras) => Ok(cameras),
        Trajectory::Keyed(_) => {
            Err(Fault::bad("it holds keyframes", "give a list of cameras").at(path))
        }
    }
}

fn of_bytes(bytes: &[u8], time_frames: usize) -> Result<Trajectory, BadPath> {
    let last_frame = (time_frames.max(1) - 1) as f64;
    let probe: Probe = json(bytes)?;
    let count = probe.frames.len().max(probe.keyframes.len());
    if count > MAX_CAMERAS {
        return Err((
            None,
            format!("it has {count} cameras, more than the {MAX_CAMERAS} that are rendered"),
        ));
    }
    match probe.format {
        Some(own) if own == FORMAT => Ok(Trajectory::Keyed(keyed(&json(bytes)?)?)),
        Some(other) => Err((None, format!("its format is {other:?}, not {FORMAT:?}"))),
        None if !probe.frames.is_empty() => {
            Ok(Trajectory::Listed(listed(json(bytes)?, last_frame)?))
        }
        None if !probe.keyframes.is_empty() => Err((
            None,
            format!("it has keyframes, but \"format\": {FORMAT:?} is missing"),
        )),
        None => Err((None, "it has no frames or keyframes".to_owned())),
    }
}

fn json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, BadPath> {
    serde_json::from_slice(bytes).map_err(|e| (None, e.to_string()))
}

/// The cameras of a `transforms.json` with the moment of each: `time` (0..1) of the file times
/// `last_frame`.
fn listed(file: Transforms, last_frame: f64) -> Result<Vec<(Camera, f64)>, BadPath> {
    let mut frames = Vec::with_capacity(file.frames.len());
    for (i, value) in file.frames.into_iter().enumerate() {
        let frame: Frame = serde_json::from_value(value).map_err(|e| (Some(i), e.to_string()))?;
        frames.push(frame);
    }
    let timed = frames.iter().filter(|f| f.time.is_some()).count();
    let camera = |(i, frame): (usize, &Frame)| -> Result<(Camera, f64), String> {
        let time = match frame.time {
            Some(time) => time,
            None if timed == 0 => i as f64 / (frames.len().max(2) - 1) as f64,
            None => {
                return Err(format!(
                    "time is missing, but {timed} other cameras have one"
                ));
            }
        };
        if !(0.0..=1.0).contains(&time) {
            return Err(format!("time = {time}; 0 to 1 was expected"));
        }
        let rows = frame
            .transform_matrix
            .as_ref()
            .ok_or("transform_matrix is missing")?;
        let pose = pose::of_rows("transform_matrix", rows).map_err(|e| e.to_string())?;
        let camera = Camera {
            intrinsics: intrinsics(frame, &file.lens)?,
            c2w: file.axes.unwrap_or_default().to_opencv(&pose),
        };
        Ok((camera, time * last_frame))
    };
    let all = frames.iter().enumerate();
    all.map(|(i, frame)| camera((i, frame)).map_err(|what| (Some(i), what)))
        .collect()
}

fn intrinsics(frame: &Frame, all: &LensKeys) -> Result<Intrinsics, String> {
    let keys = frame.lens.or(all);
    let pixels = |key: &str, value: Option<f64>| {
        let value =
            value.ok_or_else(|| format!("{key}, the size of the image in pixels, is missing"))?;
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
        Err(format!(
            "{key} = {value}; 1 to {MAX_SIDE_PX} pixels were expected"
        ))
    }
}

/// Value of `format`.
const FORMAT: &str = "minute4d-path";
/// Newest version of the layout.
const VERSION: u32 = 1;
/// Moments of a path, seconds: a day.
const SECONDS: Range = 0.0..=86_400.0;
/// Seconds from a keyframe to the next.
const STEP_S: Range = 1e-3..=86_400.0;
/// Speed of time.
const SPEED: Range = -1000.0..=1000.0;
/// Vertical fields of view, degrees.
const FOV_DEG: Range = 0.1..=179.0;
/// Frames per second.
const FPS: Range = 0.1..=240.0;

/// A camera path as keyframes.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyed {
    /// In order of time; at least one.
    pub keyframes: Vec<Keyframe>,
    /// Seconds from the last keyframe back to the first, where the path is closed.
    pub back_s: Option<f64>,
    /// Columns and rows of the images, where the file says.
    pub size: Option<(usize, usize)>,
    /// Frames per second, where the file says.
    pub fps: Option<f64>,
}

/// A place on a camera path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keyframe {
    /// When the camera is here, seconds from the start of the path; increasing.
    pub time_s: f64,
    /// Where it is and where it looks.
    pub pose: KeyPose,
    /// Vertical field of view, degrees; `None` for that of the source.
    pub fov_y_deg: Option<f64>,
    /// What moment of the scene is seen here.
    pub scene: Option<SceneTime>,
    /// Seconds of the scene that go by in a second of the path from here on, where the next
    /// keyframe names no moment.
    pub speed: Option<f64>,
}

/// Where a camera is and where it looks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum KeyPose {
    /// Camera to world, OpenCV axes.
    C2w(Se3<f64>),
    /// At `position`, with `look_at` in the middle of the image.
    LookAt {
        /// World units.
        position: Vector3<f64>,
        /// World units.
        look_at: Vector3<f64>,
        /// The direction that is upwards in the image; `None` for that of the source.
        up: Option<Vector3<f64>>,
    },
}

/// A moment of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SceneTime {
    /// Frames from the first.
    Frames(f64),
    /// Seconds from the first frame.
    Seconds(f64),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct KeyFile {
    #[serde(rename = "format")]
    _format: String,
    version: u32,
    /// Of the matrices in the file.
    #[serde(default = "opencv")]
    axes: Axes,
    width: Option<f64>,
    height: Option<f64>,
    fps: Option<f64>,
    back_s: Option<f64>,
    keyframes: Vec<Key>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Key {
    time_s: f64,
    c2w: Option<Vec<Vec<f64>>>,
    position: Option<Vec<f64>>,
    look_at: Option<Vec<f64>>,
    up: Option<Vec<f64>>,
    fov_y_deg: Option<f64>,
    scene_s: Option<f64>,
    scene_frame: Option<f64>,
    speed: Option<f64>,
}

fn opencv() -> Axes {
    Axes::OpenCv
}

/// Checks the file.
fn keyed(file: &KeyFile) -> Result<Keyed, BadPath> {
    if file.version != VERSION {
        return Err((
            None,
            format!(
                "its version is {}; version {VERSION} is known",
                file.version
            ),
        ));
    }
    if file.keyframes.is_empty() {
        return Err((None, "it has no keyframes".to_owned()));
    }
    for (field, value, range, unit) in [
        ("fps", file.fps, FPS, ""),
        ("back_s", file.back_s, STEP_S, "seconds"),
    ] {
        if let Some(what) = value.and_then(|v| range::of_number(field, v, &range, unit)) {
            return Err((None, what));
        }
    }
    let all = file.keyframes.iter().enumerate();
    let keyframes = all.map(|(i, key)| key.keyframe(file.axes).map_err(|what| (Some(i), what)));
    let keyframes: Vec<Keyframe> = keyframes.collect::<Result<_, BadPath>>()?;
    for (i, pair) in keyframes.windows(2).enumerate() {
        let [earlier, later] = [pair[0].time_s, pair[1].time_s];
        if later - earlier < *STEP_S.start() {
            let least = STEP_S.start();
            let what = format!(
                "its time, {later} s, is not behind that of the one before, {earlier} s, by {least} s or more"
            );
            return Err((Some(i + 1), what));
        }
        if pair[0].speed.is_some() && pair[1].scene.is_some() {
            let what = "it has a speed, but the next keyframe says which moment of the scene is seen there; give one of the two";
            return Err((Some(i), what.to_owned()));
        }
    }
    let size = match (file.width, file.height) {
        (Some(w), Some(h)) => side("width", w).and_then(|w| Ok(Some((w, side("height", h)?)))),
        (None, None) => Ok(None),
        _ => Err("width and height belong together; one is missing".to_owned()),
    };
    Ok(Keyed {
        keyframes,
        back_s: file.back_s,
        size: size.map_err(|what| (None, what))?,
        fps: file.fps,
    })
}

impl Key {
    fn keyframe(&self, axes: Axes) -> Result<Keyframe, String> {
        let frames = *range::FRAMES.end() as f64;
        let numbers = [
            ("time_s", Some(self.time_s), SECONDS, "seconds"),
            ("speed", self.speed, SPEED, ""),
            ("fov_y_deg", self.fov_y_deg, FOV_DEG, "degrees"),
            ("scene_s", self.scene_s, range::SECONDS, "seconds"),
            ("scene_frame", self.scene_frame, -frames..=frames, "frames"),
        ];
        for (field, value, range, unit) in numbers {
            if let Some(what) = value.and_then(|v| range::of_number(field, v, &range, unit)) {
                return Err(what);
            }
        }
        Ok(Keyframe {
            time_s: self.time_s,
            pose: self.pose(axes)?,
            fov_y_deg: self.fov_y_deg,
            scene: match (self.scene_s, self.scene_frame) {
                (None, None) => None,
                (Some(s), None) => Some(SceneTime::Seconds(s)),
                (None, Some(t)) => Some(SceneTime::Frames(t)),
                (Some(_), Some(_)) => {
                    return Err(
                        "it has both scene_s and scene_frame; give one of the two".to_owned()
                    );
                }
            },
            speed: self.speed,
        })
    }

    fn pose(&self, axes: Axes) -> Result<KeyPose, String> {
        match (&self.c2w, &self.position, &self.look_at) {
            (Some(rows), None, None) if self.up.is_none() => {
                let pose = pose::of_rows("c2w", rows).map_err(|e| e.to_string())?;
                Ok(KeyPose::C2w(axes.to_opencv(&pose)))
            }
            (None, Some(position), Some(look_at)) => {
                let position = vector("position", position)?;
                let look_at = vector("look_at", look_at)?;
                let up = self.up.as_ref().map(|up| vector("up", up)).transpose()?;
                let ahead = look_at - position;
                if ahead.norm() < 1e-9 {
                    return Err("position and look_at are the same point".to_owned());
                }
                if up.is_some_and(|up| up.cross(&ahead).norm() <= 1e-6 * up.norm() * ahead.norm()) {
                    return Err("up points where the camera looks, or has no length".to_owned());
                }
                Ok(KeyPose::LookAt {
                    position,
                    look_at,
                    up,
                })
            }
            _ => Err(
                "either c2w, or position and look_at (and up, if wanted), were expected".to_owned(),
            ),
        }
    }
}

/// Three coordinates.
fn vector(key: &str, values: &[f64]) -> Result<Vector3<f64>, String> {
    let &[x, y, z] = values else {
        return Err(format!(
            "{key} has {} numbers where x, y and z were expected",
            values.len()
        ));
    };
    let vector = Vector3::new(x, y, z);
    range::of_place(key, &vector).map_or(Ok(vector), Err)
}
