//! Camera paths of LichtFeld Studio (`--render-camera-path`).
//!
//! Layout, versions 1 to 4: `Timeline::saveToJson` in `src/sequencer/timeline.cpp`. Axes:
//! `src/rendering/include/rendering/coordinate_conventions.hpp`, and the numbers of
//! `scripts/verify_video_orientation.py`: cameras have OpenGL axes, and the world of the path is that of
//! the splats with y and z turned round. A focal length refers to a picture 24 mm high.

use super::file::Fault;
use super::keyed;
use super::{KeyPose, Keyed, Keyframe};
use m4_math::Se3;
use m4_math::nalgebra::{Matrix3, Vector3, Vector4};
use m4_math::quat;
use serde::Deserialize;
use serde::de::IgnoredAny;

/// Newest layout that is known.
const VERSION: u64 = 4;
/// Height of the picture that `focal_length_mm` refers to, millimetres.
const SENSOR_HEIGHT_MM: f64 = 24.0;
/// Shortest and longest focal length that LichtFeld Studio has, millimetres; others it clamps.
const FOCAL_MM: (f64, f64) = (10.0, 200.0);

/// Longest path, seconds: a day.
const MAX_SECONDS: f64 = 86_400.0;

#[derive(Deserialize)]
pub struct KeyFile {
    version: Option<u64>,
    keyframes: Vec<Key>,
    animation_clip: Option<IgnoredAny>,
}

#[derive(Deserialize)]
struct Key {
    time: f64,
    position: Vec<f64>,
    rotation: Vec<f64>,
    focal_length_mm: f64,
    #[serde(default)]
    easing: i64,
}

/// Keyframes; the first is at 0 s whatever the file says.
pub fn keyed(mut file: KeyFile) -> Result<Keyed, Fault> {
    if let Some(version) = file.version.filter(|v| !(1..=VERSION).contains(v)) {
        return Err(Fault::File(format!(
            "its version is {version}; paths of LichtFeld Studio with versions 1 to {VERSION} are known"
        )));
    }
    // As it does itself: keyframes need not be written in order.
    file.keyframes.sort_by(|a, b| a.time.total_cmp(&b.time));
    let start_s = file.keyframes.first().map_or(0.0, |key| key.time);
    let keyframes: Result<Vec<Keyframe>, Fault> = file
        .keyframes
        .iter()
        .enumerate()
        .map(|(i, key)| key.keyframe(start_s).map_err(|what| (i, what).into()))
        .collect();
    let mut remarks = Vec::new();
    if file.keyframes.iter().any(|key| key.easing != 0) {
        remarks.push("the easing of the keyframes is left out: the camera goes through them smoothly".to_owned());
    }
    if file.animation_clip.is_some() {
        remarks.push("the animation clip of the camera path is left out".to_owned());
    }
    Ok(Keyed {
        keyframes: keyframes?,
        back_s: None,
        size: None,
        fps: None,
        remarks,
    })
}

impl Key {
    fn keyframe(&self, start_s: f64) -> Result<Keyframe, String> {
        if !(-MAX_SECONDS..=MAX_SECONDS).contains(&self.time) {
            return Err(format!("time = {}; at most {MAX_SECONDS} s were expected", self.time));
        }
        let position = keyed::vector("position", &self.position)?;
        let &[w, x, y, z] = &self.rotation[..] else {
            return Err(format!(
                "rotation has {} numbers where w, x, y and z were expected",
                self.rotation.len()
            ));
        };
        let q = Vector4::new(w, x, y, z);
        let length = q.norm();
        if !(length.is_finite() && length > 1e-6) {
            return Err(format!("rotation = [{w}, {x}, {y}, {z}] is no rotation"));
        }
        let focal_mm = self.focal_length_mm;
        if !(focal_mm.is_finite() && focal_mm > 0.0) {
            return Err(format!("focal_length_mm = {focal_mm}; a length above 0 was expected"));
        }
        let focal_mm = focal_mm.clamp(FOCAL_MM.0, FOCAL_MM.1);
        let turned = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
        Ok(Keyframe {
            time_s: self.time - start_s,
            pose: KeyPose::C2w(Se3 {
                rotation: turned * quat::rotation(&q) * turned,
                translation: turned * position,
            }),
            fov_y_deg: Some((2.0 * (0.5 * SENSOR_HEIGHT_MM / focal_mm).atan()).to_degrees()),
            scene: None,
            speed: None,
        })
    }
}
