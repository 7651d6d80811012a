//! Keyframes of a camera path.

use m4_core::{Se3, nalgebra::Vector3};

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

/// Largest coordinate that is taken, world units: beyond, single precision has no places left.
const MAX_COORDINATE: f64 = 1e9;

/// Largest side of an image to render, pixels.
const MAX_SIDE_PX: f64 = 16_384.0;

/// Three finite numbers.
pub fn vector(key: &str, values: &[f64]) -> Result<Vector3<f64>, String> {
    let &[x, y, z] = values else {
        return Err(format!(
            "{key} has {} numbers where x, y and z were expected",
            values.len()
        ));
    };
    let fits = [x, y, z].iter().all(|v| v.is_finite() && v.abs() <= MAX_COORDINATE);
    fits.then(|| Vector3::new(x, y, z))
        .ok_or_else(|| format!("{key} = [{x}, {y}, {z}]; numbers up to {MAX_COORDINATE:e} were expected"))
}

/// A vertical field of view, degrees.
pub fn fov(key: &str, value: f64) -> Result<f64, String> {
    if value > 0.0 && value < 180.0 {
        Ok(value)
    } else {
        Err(format!("{key} = {value}; 0 to 180 degrees were expected"))
    }
}

/// Refuses keyframes that do not come one after the other.
pub fn check_order(keyframes: &[Keyframe]) -> Result<(), (usize, String)> {
    let mut earlier = f64::NEG_INFINITY;
    for (i, key) in keyframes.iter().enumerate() {
        if key.time_s <= earlier {
            let what = format!(
                "its time, {} s, is not behind that of the one before, {earlier} s",
                key.time_s
            );
            return Err((i, what));
        }
        earlier = key.time_s;
    }
    Ok(())
}

/// A number of pixels.
pub fn side(key: &str, value: f64) -> Result<usize, String> {
    if value.fract() == 0.0 && (1.0..=MAX_SIDE_PX).contains(&value) {
        Ok(value as usize)
    } else {
        Err(format!("{key} = {value}; 1 to {MAX_SIDE_PX} pixels were expected"))
    }
}
