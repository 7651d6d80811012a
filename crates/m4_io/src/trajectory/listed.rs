//! Files that list one camera per image: `transforms.json`, and `camera_path` of the nerfstudio viewer.

use super::Listed;
use super::file::Fault;
use super::keyed::fov;
use super::nerfstudio::{Header, side};
use crate::capture::{Axes, Lens, Pose};
use m4_core::{Camera, Intrinsics};
use serde::Deserialize;

#[derive(Deserialize)]
pub struct PathFile {
    #[serde(flatten)]
    lens: Lens,
    #[serde(flatten)]
    header: Header,
    #[serde(default)]
    axes: Axes,
    /// transforms.json
    #[serde(default)]
    frames: Vec<Stop>,
    /// camera_path.json
    #[serde(default)]
    camera_path: Vec<Stop>,
}

#[derive(Deserialize)]
struct Stop {
    #[serde(flatten)]
    lens: Lens,
    transform_matrix: Option<Vec<Vec<f64>>>,
    camera_to_world: Option<Vec<f64>>,
    /// Vertical, degrees.
    fov: Option<f64>,
    time: Option<f64>,
    render_time: Option<f64>,
}

/// The cameras with the moment of each: `time` (0..1) of the file times `last_frame`.
pub fn listed(file: &PathFile, last_frame: f64) -> Result<Listed, Fault> {
    let stops = if file.frames.is_empty() {
        &file.camera_path
    } else {
        &file.frames
    };
    let timed = stops.iter().filter(|s| s.time.or(s.render_time).is_some()).count();
    let mut cameras = Vec::with_capacity(stops.len());
    for (i, stop) in stops.iter().enumerate() {
        let bad = |what: String| (i, what);
        let time = match stop.time.or(stop.render_time) {
            Some(time) => time,
            None if timed == 0 => i as f64 / (stops.len().max(2) - 1) as f64,
            None => return Err(bad(format!("time is missing, but {timed} other cameras have one")).into()),
        };
        if !(0.0..=1.0).contains(&time) {
            return Err(bad(format!("time = {time}; 0 to 1 was expected")).into());
        }
        let camera = Camera {
            intrinsics: file.intrinsics(stop).map_err(bad)?,
            c2w: file.axes.to_opencv(&pose(stop).map_err(bad)?.0),
        };
        cameras.push((camera, time * last_frame));
    }
    Ok(Listed {
        cameras,
        fps: file.header.fps()?,
        remarks: file.header.remarks()?,
    })
}

/// The matrix of a camera, whichever way it is written.
fn pose(stop: &Stop) -> Result<Pose, String> {
    let named = |key: &'static str| move |fault| format!("{key} {fault}");
    if let Some(rows) = &stop.transform_matrix {
        return Pose::from_rows(rows).map_err(named("transform_matrix"));
    }
    match &stop.camera_to_world {
        Some(numbers) => {
            let rows: Vec<&[f64]> = numbers.chunks(4).collect();
            Pose::from_rows(&rows).map_err(named("camera_to_world"))
        }
        None => Err("transform_matrix or camera_to_world is missing".into()),
    }
}

impl PathFile {
    fn intrinsics(&self, stop: &Stop) -> Result<Intrinsics, String> {
        let mut lens = stop.lens.or(&self.lens);
        let pixels = |keys: &str, value: Option<f64>| {
            let value = value.ok_or_else(|| format!("{keys}, the size of the image in pixels, is missing"))?;
            side(keys, value)
        };
        let width = pixels("w (or render_width)", lens.w.or(self.header.render_width))?;
        let height = pixels("h (or render_height)", lens.h.or(self.header.render_height))?;
        if let Some((key, value)) = lens.distortion() {
            return Err(format!("{key} = {value}; only cameras without distortion are rendered"));
        }
        if let Some(degrees) = stop.fov {
            let half = 0.5 * fov("fov", degrees)?.to_radians();
            lens.fl_x = Some(0.5 * height as f64 / half.tan());
            lens.fl_y = None;
        }
        lens.intrinsics((width, height))
    }
}
