//! Files of the nerfstudio viewer: its `keyframes`, and the parts common to both of its lists.
//!
//! Layout: `nerfstudio/viewer/render_panel.py` (`_write_json`). `matrix` is row-major numbers with OpenGL
//! axes; up to version 0.3 it was column-major text (`JSON.stringify` of a three.js matrix).

use super::file::Fault;
use super::keyed;
use super::{KeyPose, Keyed, Keyframe, SceneTime};
use crate::capture::{Axes, Pose};
use m4_core::Se3;
use serde::Deserialize;

/// Largest side of an image to render, pixels.
pub const MAX_SIDE_PX: f64 = 16_384.0;
/// Seconds between keyframes where the file does not say: the viewer's own.
const TRANSITION_S: f64 = 2.0;
/// Longest way between two keyframes that is taken, seconds: an hour.
const MAX_TRANSITION_S: f64 = 3600.0;

/// Of the file as a whole.
#[derive(Debug, Default, Deserialize)]
pub struct Header {
    pub camera_type: Option<String>,
    pub render_width: Option<f64>,
    pub render_height: Option<f64>,
    pub fps: Option<f64>,
    pub crop: Option<serde::de::IgnoredAny>,
}

impl Header {
    /// Frames a second.
    pub fn fps(&self) -> Result<Option<f64>, String> {
        match self.fps {
            Some(fps) if !(0.1..=240.0).contains(&fps) => Err(format!("fps = {fps}; 0.1 to 240 were expected")),
            fps => Ok(fps),
        }
    }

    /// Refuses lenses that are not rendered; what has no effect.
    pub fn remarks(&self) -> Result<Vec<String>, String> {
        if let Some(kind) = self.camera_type.as_deref().filter(|kind| *kind != "perspective") {
            return Err(format!("camera_type = {kind:?}; only perspective cameras are rendered"));
        }
        let crop = "the crop box of the camera path is left out: the whole scene is rendered";
        Ok(self.crop.iter().map(|_| crop.to_owned()).collect())
    }
}

/// A number of pixels.
pub fn side(keys: &str, value: f64) -> Result<usize, String> {
    if value.fract() == 0.0 && (1.0..=MAX_SIDE_PX).contains(&value) {
        Ok(value as usize)
    } else {
        Err(format!("{keys} = {value}; 1 to {MAX_SIDE_PX} pixels were expected"))
    }
}

/// Columns and rows, where both are given.
pub fn size(width: (&str, Option<f64>), height: (&str, Option<f64>)) -> Result<Option<(usize, usize)>, String> {
    match (width.1, height.1) {
        (Some(w), Some(h)) => Ok(Some((side(width.0, w)?, side(height.0, h)?))),
        (None, None) => Ok(None),
        _ => Err(format!("{} and {} belong together; one is missing", width.0, height.0)),
    }
}

/// 16 numbers, or 16 numbers as text.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
pub enum Matrix {
    List(Vec<f64>),
    Text(String),
}

impl Matrix {
    /// Camera to world, in the axes of the file.
    pub fn pose(&self) -> Result<Se3<f64>, String> {
        let (numbers, transposed) = match self {
            Self::List(numbers) => (numbers.clone(), false),
            Self::Text(text) => (serde_json::from_str(text).map_err(|e| format!("matrix: {e}"))?, true),
        };
        let at = |i: usize, j: usize| {
            if transposed {
                numbers[4 * j + i]
            } else {
                numbers[4 * i + j]
            }
        };
        if numbers.len() != 16 {
            return Err(format!("matrix has {} numbers where 16 were expected", numbers.len()));
        }
        let rows: Vec<[f64; 4]> = (0..4).map(|i| std::array::from_fn(|j| at(i, j))).collect();
        Pose::from_rows(&rows).map(|p| p.0).map_err(|e| format!("matrix {e}"))
    }
}

/// `camera_path.json` before it was smoothed.
#[derive(Deserialize)]
pub struct KeyFile {
    #[serde(flatten)]
    header: Header,
    default_fov: Option<f64>,
    default_time: Option<f64>,
    default_transition_sec: Option<f64>,
    #[serde(default)]
    is_cycle: bool,
    keyframes: Vec<Key>,
}

#[derive(Deserialize)]
struct Key {
    matrix: Option<Matrix>,
    fov: Option<f64>,
    render_time: Option<f64>,
    override_transition_enabled: Option<bool>,
    override_transition_sec: Option<f64>,
}

impl Key {
    /// Seconds from the keyframe before.
    fn transition_s(&self, default_s: f64) -> Result<f64, String> {
        let own = self
            .override_transition_sec
            .filter(|_| self.override_transition_enabled == Some(true));
        let seconds = own.unwrap_or(default_s);
        if seconds > 0.0 && seconds <= MAX_TRANSITION_S {
            Ok(seconds)
        } else {
            Err(format!(
                "the transition takes {seconds} s; more than 0 and at most {MAX_TRANSITION_S} were expected"
            ))
        }
    }
}

/// Keyframes of `camera_path.json`.
pub fn keyed(file: &KeyFile, last_frame: f64) -> Result<Keyed, Fault> {
    let default_s = file.default_transition_sec.unwrap_or(TRANSITION_S);
    let mut time_s = 0.0;
    let mut keyframes = Vec::with_capacity(file.keyframes.len());
    for (i, key) in file.keyframes.iter().enumerate() {
        let bad = |what: String| (i, what);
        if i > 0 {
            time_s += key.transition_s(default_s).map_err(bad)?;
        }
        let matrix = key.matrix.as_ref().ok_or_else(|| bad("matrix is missing".to_owned()))?;
        let pose = Axes::OpenGl.to_opencv(&matrix.pose().map_err(bad)?);
        let fov = key.fov.or(file.default_fov);
        let share = key.render_time.or(file.default_time);
        if let Some(share) = share.filter(|share| !(0.0..=1.0).contains(share)) {
            return Err(bad(format!("render_time = {share}; 0 to 1 was expected")).into());
        }
        keyframes.push(Keyframe {
            time_s,
            pose: KeyPose::C2w(pose),
            fov_y_deg: fov.map(|fov| keyed::fov("fov", fov)).transpose().map_err(bad)?,
            scene: share.map(|share| SceneTime::Frames(share * last_frame)),
            speed: None,
        });
    }
    let back_s = match file.keyframes.first() {
        Some(first) if file.is_cycle => Some(first.transition_s(default_s).map_err(|what| (0, what))?),
        _ => None,
    };
    let header = &file.header;
    Ok(Keyed {
        keyframes,
        back_s,
        size: size(
            ("render_width", header.render_width),
            ("render_height", header.render_height),
        )?,
        fps: header.fps()?,
        remarks: header.remarks()?,
    })
}
