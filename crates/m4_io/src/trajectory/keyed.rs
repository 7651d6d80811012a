//! Keyframes of a camera path; the layout is described for users in `docs/paths.md`.

use super::{BadPath, side};
use crate::pose::{self, Axes};
use m4_core::{Se3, nalgebra::Vector3};
use serde::Deserialize;

/// Value of `format`.
pub const FORMAT: &str = "minute4d-path";
/// Newest version of the layout.
const VERSION: u32 = 1;
/// Longest path, seconds: a day.
const MAX_SECONDS: f64 = 86_400.0;
/// Greatest speed of time.
const MAX_SPEED: f64 = 1000.0;
/// Largest coordinate that is taken, world units: beyond, single precision has no places left.
const MAX_COORDINATE: f64 = 1e9;

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
    /// Seconds of the scene that go by in a second of the path from here on, where the next keyframe
    /// names no moment.
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
pub struct KeyFile {
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
pub fn keyed(file: &KeyFile) -> Result<Keyed, BadPath> {
    if file.version != VERSION {
        return Err(format!("its version is {}; version {VERSION} is known", file.version).into());
    }
    if file.keyframes.is_empty() {
        return Err("it has no keyframes".to_owned().into());
    }
    if let Some(fps) = file.fps.filter(|fps| !(0.1..=240.0).contains(fps)) {
        return Err(format!("fps = {fps}; 0.1 to 240 were expected").into());
    }
    if let Some(back_s) = file.back_s.filter(|s| !(*s > 0.0 && *s <= MAX_SECONDS)) {
        return Err(format!("back_s = {back_s}; a time above 0 was expected").into());
    }
    let keyframes: Result<Vec<Keyframe>, BadPath> = file
        .keyframes
        .iter()
        .enumerate()
        .map(|(i, key)| key.keyframe(file.axes).map_err(|what| (i, what).into()))
        .collect();
    let keyframes = keyframes?;
    check_order(&keyframes)?;
    for (i, pair) in keyframes.windows(2).enumerate() {
        if pair[0].speed.is_some() && pair[1].scene.is_some() {
            let what = "it has a speed, but the next keyframe says which moment of the scene is seen there; give one of the two";
            return Err((i, what.to_owned()).into());
        }
    }
    Ok(Keyed {
        keyframes,
        back_s: file.back_s,
        size: match (file.width, file.height) {
            (Some(w), Some(h)) => Some((side("width", w)?, side("height", h)?)),
            (None, None) => None,
            _ => return Err("width and height belong together; one is missing".to_owned().into()),
        },
        fps: file.fps,
    })
}

impl Key {
    fn keyframe(&self, axes: Axes) -> Result<Keyframe, String> {
        if !(0.0..=MAX_SECONDS).contains(&self.time_s) {
            return Err(format!("time_s = {}; 0 to {MAX_SECONDS} was expected", self.time_s));
        }
        if let Some(speed) = self.speed.filter(|v| !(-MAX_SPEED..=MAX_SPEED).contains(v)) {
            return Err(format!("speed = {speed}; at most {MAX_SPEED} was expected"));
        }
        Ok(Keyframe {
            time_s: self.time_s,
            pose: self.pose(axes)?,
            fov_y_deg: self.fov_y_deg.map(|v| fov("fov_y_deg", v)).transpose()?,
            scene: match (self.scene_s, self.scene_frame) {
                (None, None) => None,
                (Some(s), None) => Some(SceneTime::Seconds(s)),
                (None, Some(t)) => Some(SceneTime::Frames(t)),
                (Some(_), Some(_)) => return Err("it has both scene_s and scene_frame; give one of the two".to_owned()),
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
                Ok(KeyPose::LookAt { position, look_at, up })
            }
            _ => Err("either c2w, or position and look_at (and up, if wanted), were expected".to_owned()),
        }
    }
}

/// Three finite numbers.
fn vector(key: &str, values: &[f64]) -> Result<Vector3<f64>, String> {
    let &[x, y, z] = values else {
        return Err(format!("{key} has {} numbers where x, y and z were expected", values.len()));
    };
    let fits = [x, y, z].iter().all(|v| v.is_finite() && v.abs() <= MAX_COORDINATE);
    fits.then(|| Vector3::new(x, y, z))
        .ok_or_else(|| format!("{key} = [{x}, {y}, {z}]; numbers up to {MAX_COORDINATE:e} were expected"))
}

/// A vertical field of view, degrees.
fn fov(key: &str, value: f64) -> Result<f64, String> {
    if value > 0.0 && value < 180.0 {
        Ok(value)
    } else {
        Err(format!("{key} = {value}; 0 to 180 degrees were expected"))
    }
}

/// Refuses keyframes that do not come one after the other.
fn check_order(keyframes: &[Keyframe]) -> Result<(), (usize, String)> {
    let mut earlier = f64::NEG_INFINITY;
    for (i, key) in keyframes.iter().enumerate() {
        if key.time_s <= earlier {
            let what = format!("its time, {} s, is not behind that of the one before, {earlier} s", key.time_s);
            return Err((i, what));
        }
        earlier = key.time_s;
    }
    Ok(())
}
