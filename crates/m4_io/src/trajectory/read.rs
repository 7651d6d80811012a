//! A camera path file to cameras.

use super::ReadTrajectoryError;
use crate::capture::{Axes, Lens, Pose};
use m4_scene::{Camera, Intrinsics};
use serde::Deserialize;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Longest file that is read, bytes: half a kilobyte a camera, so a hundred thousand cameras.
const MAX_BYTES: u64 = 64 << 20;
/// Largest side of a picture to render, pixels.
const MAX_SIDE_PX: f64 = 16_384.0;

#[derive(Deserialize)]
struct PathFile {
    #[serde(flatten)]
    lens: Lens,
    #[serde(default)]
    axes: Axes,
    render_width: Option<f64>,
    render_height: Option<f64>,
    /// transforms.json
    frames: Option<Vec<Stop>>,
    /// camera_path.json
    camera_path: Option<Vec<Stop>>,
    /// camera_path.json before it was smoothed
    keyframes: Option<Vec<Stop>>,
}

#[derive(Deserialize)]
struct Stop {
    #[serde(flatten)]
    lens: Lens,
    transform_matrix: Option<Vec<Vec<f64>>>,
    camera_to_world: Option<Vec<f64>>,
    /// Column-major, a list or a list as text.
    matrix: Option<Matrix>,
    /// Vertical, degrees.
    fov: Option<f64>,
    time: Option<f64>,
    render_time: Option<f64>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Matrix {
    List(Vec<f64>),
    Text(String),
}

/// Reads the cameras of a path with the moment of each, frames: `time` (0..1) of the file times
/// `time_frames - 1`. A path without any times runs evenly through the whole scene.
///
/// # Errors
///
/// [`ReadTrajectoryError`], which names the file and the camera at fault.
pub fn read(path: &Path, time_frames: usize) -> Result<Vec<(Camera, f64)>, ReadTrajectoryError> {
    let json = |reason: String| ReadTrajectoryError::Json {
        path: path.to_path_buf(),
        reason,
    };
    let file = parse(path)?;
    let lists = [&file.frames, &file.camera_path, &file.keyframes];
    let stops = lists.into_iter().flatten().find(|list| !list.is_empty());
    let stops = stops.ok_or_else(|| json("it has no frames, camera_path or keyframes".into()))?;
    let timed = stops.iter().filter(|s| s.time.or(s.render_time).is_some()).count();
    let last_frame = (time_frames.max(1) - 1) as f64;
    let mut cameras = Vec::with_capacity(stops.len());
    for (i, stop) in stops.iter().enumerate() {
        let bad = |what: String| ReadTrajectoryError::BadCamera {
            path: path.to_path_buf(),
            camera: i,
            what,
        };
        let time = match stop.time.or(stop.render_time) {
            Some(time) => time,
            None if timed == 0 => i as f64 / (stops.len().max(2) - 1) as f64,
            None => return Err(bad(format!("time is missing, but {timed} other cameras have one"))),
        };
        if !(0.0..=1.0).contains(&time) {
            return Err(bad(format!("time = {time}; 0 to 1 was expected")));
        }
        let camera = Camera {
            intrinsics: file.intrinsics(stop).map_err(bad)?,
            c2w: file.axes.to_opencv(&pose(stop).map_err(bad)?.0),
        };
        cameras.push((camera, time * last_frame));
    }
    Ok(cameras)
}

fn parse(path: &Path) -> Result<PathFile, ReadTrajectoryError> {
    let io = |source| ReadTrajectoryError::Io {
        path: path.to_path_buf(),
        source,
    };
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(io)?;
    file.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(io)?;
    let json = |reason: String| ReadTrajectoryError::Json {
        path: path.to_path_buf(),
        reason,
    };
    if bytes.len() as u64 > MAX_BYTES {
        return Err(json("it is larger than 64 MiB".into()));
    }
    serde_json::from_slice(&bytes).map_err(|e| json(e.to_string()))
}

/// The matrix of a camera, whichever way it is written.
fn pose(stop: &Stop) -> Result<Pose, String> {
    let named = |key: &'static str| move |fault| format!("{key} {fault}");
    if let Some(rows) = &stop.transform_matrix {
        return Pose::from_rows(rows).map_err(named("transform_matrix"));
    }
    if let Some(numbers) = &stop.camera_to_world {
        let rows: Vec<&[f64]> = numbers.chunks(4).collect();
        return Pose::from_rows(&rows).map_err(named("camera_to_world"));
    }
    let columns = match &stop.matrix {
        Some(Matrix::List(list)) => list.clone(),
        Some(Matrix::Text(text)) => serde_json::from_str(text).map_err(|e| format!("matrix: {e}"))?,
        None => return Err("transform_matrix, camera_to_world or matrix is missing".into()),
    };
    if columns.len() != 16 {
        return Err(format!("matrix has {} numbers where 16 were expected", columns.len()));
    }
    let rows: Vec<[f64; 4]> = (0..4).map(|r| std::array::from_fn(|c| columns[4 * c + r])).collect();
    Pose::from_rows(&rows).map_err(named("matrix"))
}

impl PathFile {
    fn intrinsics(&self, stop: &Stop) -> Result<Intrinsics, String> {
        let mut lens = stop.lens.or(&self.lens);
        let side = |keys: &str, value: Option<f64>| {
            let value = value.ok_or_else(|| format!("{keys}, the size of the picture in pixels, is missing"))?;
            let fits = value.fract() == 0.0 && (1.0..=MAX_SIDE_PX).contains(&value);
            fits.then_some(value)
                .ok_or_else(|| format!("{keys} = {value}; 1 to {MAX_SIDE_PX} pixels were expected"))
        };
        let width = side("w (or render_width)", lens.w.or(self.render_width))?;
        let height = side("h (or render_height)", lens.h.or(self.render_height))?;
        if let Some((key, value)) = lens.distortion() {
            return Err(format!("{key} = {value}; only cameras without distortion are rendered"));
        }
        if let Some(fov) = stop.fov {
            if !(fov > 0.0 && fov < 180.0) {
                return Err(format!("fov = {fov}; 0 to 180 degrees were expected"));
            }
            lens.fl_x = Some(0.5 * height / (0.5 * fov).to_radians().tan());
            lens.fl_y = None;
        }
        lens.intrinsics((width as usize, height as usize))
    }
}

#[cfg(test)]
mod tests {
    use super::read;
    use m4_math::nalgebra::Vector3;

    fn of(text: &str) -> Result<Vec<(m4_scene::Camera, f64)>, String> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("path.json");
        std::fs::write(&path, text).unwrap();
        read(&path, 11).map_err(|e| e.to_string())
    }

    #[test]
    fn a_camera_path_of_the_nerfstudio_viewer() {
        // One unit along x, looking along -z, 90 degrees high.
        let got = of(
            r#"{"camera_type": "perspective", "render_height": 100, "render_width": 200, "fps": 24, "seconds": 4,
            "camera_path": [
              {"camera_to_world": [1,0,0,1, 0,1,0,0, 0,0,1,0, 0,0,0,1], "fov": 90, "aspect": 2},
              {"camera_to_world": [1,0,0,2, 0,1,0,0, 0,0,1,0, 0,0,0,1], "fov": 90, "aspect": 2}],
            "keyframes": [{"matrix": "[1,0,0,0,0,1,0,0,0,0,1,0,9,0,0,1]", "fov": 50}]}"#,
        )
        .unwrap();
        assert_eq!(got.iter().map(|(_, t)| *t).collect::<Vec<_>>(), [0.0, 10.0]);
        let camera = got[1].0;
        let k = camera.intrinsics;
        assert_eq!((k.width, k.height, k.cx, k.cy), (200, 100, 100.0, 50.0));
        assert!((k.fy - 50.0).abs() < 1e-9 && (k.fx - 50.0).abs() < 1e-9);
        assert_eq!(camera.centre(), Vector3::new(2.0, 0.0, 0.0));
        assert!((camera.unproject(99.5, 49.5, 3.0) - Vector3::new(2.0, 0.0, -3.0)).norm() < 1e-12);
    }

    #[test]
    fn keyframes_and_transforms() {
        let got = of(r#"{"render_height": 10, "render_width": 20,
            "keyframes": [{"matrix": "[1,0,0,0,0,1,0,0,0,0,1,0,9,8,7,1]", "fov": 50, "render_time": 0.5}]}"#)
        .unwrap();
        assert_eq!((got[0].0.centre(), got[0].1), (Vector3::new(9.0, 8.0, 7.0), 5.0));
        let got = of(r#"{"fl_x": 30, "w": 20, "h": 10, "axes": "opencv", "frames": [
            {"transform_matrix": [[1,0,0,3],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "time": 1.0}]}"#)
        .unwrap();
        assert_eq!(got[0].1, 10.0);
        assert!((got[0].0.unproject(9.5, 4.5, 2.0) - Vector3::new(3.0, 0.0, 2.0)).norm() < 1e-12);
    }

    #[test]
    fn messages_name_the_camera_and_the_key() {
        let error = of(r#"{"frames": []}"#).unwrap_err();
        assert!(error.contains("no frames") && error.contains("path.json"), "{error}");
        let error = of(r#"{"frames": [{"transform_matrix": [[1,0,0,3],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#).unwrap_err();
        assert!(error.contains("camera 0") && error.contains("render_width"), "{error}");
        let error =
            of(r#"{"render_width": 9, "render_height": 9, "camera_path": [{"camera_to_world": [1,2,3], "fov": 9}]}"#)
                .unwrap_err();
        assert!(error.contains("camera_to_world") && error.contains("4 rows"), "{error}");
        let error =
            of(r#"{"render_width": 9, "render_height": 9, "camera_path": [{"matrix": [1], "fov": 270}]}"#).unwrap_err();
        assert!(error.contains("fov = 270"), "{error}");
        assert!(of("[1, 2").unwrap_err().contains("is not a camera path"));
    }
}
