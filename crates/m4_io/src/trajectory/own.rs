//! The keyframes of minute4d; the layout is described for users in `docs/paths.md`.

use super::file::BadPath;
use super::keyed::{fov, side, vector};
use super::{KeyPose, Keyed, Keyframe, SceneTime};
use crate::capture::{Axes, Pose};
use serde::Deserialize;

/// Value of `format`.
pub const FORMAT: &str = "minute4d-path";
/// Newest version of the layout.
const VERSION: u32 = 1;
/// Longest path, seconds: a day.
const MAX_SECONDS: f64 = 86_400.0;
/// Greatest speed of time.
const MAX_SPEED: f64 = 1000.0;

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

/// Checks everything but the order of the keyframes.
pub fn keyed(file: KeyFile) -> Result<Keyed, BadPath> {
    if file.version != VERSION {
        return Err(BadPath::File(format!(
            "its version is {}; version {VERSION} is known",
            file.version
        )));
    }
    if file.keyframes.is_empty() {
        return Err(BadPath::File("it has no keyframes".to_owned()));
    }
    if let Some(fps) = file.fps.filter(|fps| !(0.1..=240.0).contains(fps)) {
        return Err(BadPath::File(format!("fps = {fps}; 0.1 to 240 were expected")));
    }
    if let Some(back_s) = file.back_s.filter(|s| !(*s > 0.0 && *s <= MAX_SECONDS)) {
        return Err(BadPath::File(format!("back_s = {back_s}; a time above 0 was expected")));
    }
    let keyframes: Result<Vec<Keyframe>, BadPath> = file
        .keyframes
        .iter()
        .enumerate()
        .map(|(i, key)| key.keyframe(file.axes).map_err(|what| (i, what).into()))
        .collect();
    let keyframes = keyframes?;
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
            _ => {
                return Err(BadPath::File(
                    "width and height belong together; one is missing".to_owned(),
                ));
            }
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
                let pose = Pose::from_rows(rows).map_err(|e| format!("c2w {e}"))?;
                Ok(KeyPose::C2w(axes.to_opencv(&pose.0)))
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
