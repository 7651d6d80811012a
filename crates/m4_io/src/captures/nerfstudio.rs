//! Writes a capture as a folder of nerfstudio (`ns-train ... nerfstudio-data --data OUT`), which many tools read.
//!
//! ```text
//! images/00000.png       training frames; test_00000.png: held-out views
//! masks/00000.png        0 in dynamic regions: nerfstudio trains where a mask is not 0
//! depths/00000.png       z-depth in 16 bits, steps of depth_unit_scale_factor (0.001 where that fits, nerfstudio's own default)
//! points.ply             points of static regions: x y z, red green blue
//! transforms.json        lens and pose per frame (camera to world, OpenGL axes: right, up, back), time 0..1,
//!                        train_filenames, test_filenames where there are held-out views
//! ```
//!
//! Poses are in the world of the capture: nerfstudio turns and scales them for itself (`--orientation-method none --center-method none
//! --auto-scale-poses False` keeps them).

use super::WriteCaptureAsError;
use super::check::check;
use super::pictures::{self, Places};
use super::points::{CapturePoint, of_what_rests};
use super::staging::Staging;
use crate::capture::{Axes, depth_unit};
use crate::scene::{Loss, WriteFileError, Written};
use crate::trajectory;
use m4_core::{Capture, CaptureFrame, Progress};
use serde_json::{Map, Value, json};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

const LIST: &str = "transforms.json";
const POINTS: &str = "points.ply";
/// nerfstudio's own unit of depth maps.
const UNIT: f64 = 1e-3;
/// Where even the farthest is nearer, that unit is too coarse.
const LEAST_FAR: f64 = 2.0;
const MAX_POINTS: usize = 100_000;
/// Largest difference of a pose that is read back, of its size.
const POSE_WITHIN: f64 = 1e-6;

/// Writes a capture, and held-out views beside it, into the folder `out`, where files of the same names are replaced.
///
/// # Errors
///
/// [`WriteCaptureAsError`]: nothing is then changed, unless the last renames fail.
pub fn write(
    out: &Path,
    train: &Capture,
    test: Option<&Capture>,
    progress: &dyn Progress,
) -> Result<Written, WriteCaptureAsError> {
    check(out, train)?;
    if let Some(test) = test {
        check(out, test)?;
    }
    let staging = Staging::new(out)?;
    let held_out = test.map_or(&[][..], |t| &t.frames);
    let named = |prefix: &'static str| move |(i, frame): (usize, _)| (places(prefix, i, frame), frame);
    let frames: Vec<(Places, &CaptureFrame)> = train
        .frames
        .iter()
        .enumerate()
        .map(named(""))
        .chain(held_out.iter().enumerate().map(named("test_")))
        .collect();
    let unit = unit(train);
    let last = train.time_frames.max(2) as f64 - 1.0;
    let points = of_what_rests(train, MAX_POINTS);
    let mut list = list(train, &frames, unit, last);
    if !points.is_empty() {
        list.insert("ply_file_path".into(), json!(POINTS));
    }
    let frames: Vec<_> = frames.into_iter().map(|(places, frame)| (frame, places)).collect();
    let clipped = pictures::write(staging.path(), out, &frames, unit, progress)?;
    let put = |name: &str, bytes: &[u8]| {
        let path = staging.path().join(name);
        let io = |e| WriteFileError::io(&out.join(name), e);
        fs::write(&path, bytes).map_err(io)?;
        match fs::read(&path).map_err(io)? == bytes {
            true => Ok(()),
            false => Err(WriteFileError::verify(&out.join(name), "its bytes are others")),
        }
    };
    if !points.is_empty() {
        put(POINTS, &ply(&points))?;
    }
    let mut text = serde_json::to_vec_pretty(&list).map_err(|e| WriteFileError::io(&out.join(LIST), e.into()))?;
    text.push(b'\n');
    put(LIST, &text)?;
    read_back(&staging.path().join(LIST), out, &frames, train.time_frames)?;
    Ok(Written {
        path: out.to_path_buf(),
        bytes: staging.commit(LIST)?,
        splats: 0,
        losses: losses(train, unit, clipped),
    })
}

fn places(prefix: &str, i: usize, frame: &CaptureFrame) -> Places {
    let file = |folder: &str| format!("{folder}/{prefix}{i:05}.png");
    Places {
        picture: file("images"),
        mask: frame.mask.as_ref().map(|_| file("masks")),
        depth: frame.depth.as_ref().map(|_| file("depths")),
    }
}

/// Millimetres where these are neither too coarse nor too few.
fn unit(train: &Capture) -> f64 {
    let farthest = train
        .frames
        .iter()
        .filter_map(|f| f.depth.as_ref())
        .flat_map(|d| d.every(1))
        .filter(|z| z.is_finite())
        .fold(0.0f32, f32::max);
    if (LEAST_FAR..=65535.0 * UNIT).contains(&f64::from(farthest)) {
        UNIT
    } else {
        depth_unit(train)
    }
}

fn list(train: &Capture, frames: &[(Places, &CaptureFrame)], unit: f64, last: f64) -> Map<String, Value> {
    let mut root = Map::new();
    root.insert("camera_model".into(), json!("OPENCV"));
    root.insert("depth_unit_scale_factor".into(), json!(unit));
    if let Some(duration_s) = train.duration_s {
        root.insert("duration_s".into(), json!(duration_s));
    }
    let names = |from: &[(Places, &CaptureFrame)]| from.iter().map(|(p, _)| p.picture.clone()).collect::<Vec<_>>();
    let (own, held_out) = frames.split_at(train.frames.len());
    if !held_out.is_empty() {
        root.insert("train_filenames".into(), json!(names(own)));
        root.insert("val_filenames".into(), json!(names(held_out)));
        root.insert("test_filenames".into(), json!(names(held_out)));
    }
    let entries = frames.iter().map(|(places, frame)| {
        let k = &frame.camera.intrinsics;
        let pose = Axes::OpenGl.to_opencv(&frame.camera.c2w).matrix();
        // no -0
        let rows: [[f64; 4]; 4] = std::array::from_fn(|i| std::array::from_fn(|j| pose[(i, j)] + 0.0));
        let mut entry = json!({
            "file_path": places.picture, "time": frame.t / last, "w": k.width, "h": k.height,
            "fl_x": k.fx, "fl_y": k.fy, "cx": k.cx, "cy": k.cy, "transform_matrix": rows,
        });
        if let Some(mask) = &places.mask {
            entry["mask_path"] = json!(mask);
        }
        if let Some(depth) = &places.depth {
            entry["depth_file_path"] = json!(depth);
        }
        entry
    });
    root.insert("frames".into(), entries.collect());
    root
}

fn read_back(
    list: &Path,
    out: &Path,
    frames: &[(&CaptureFrame, Places)],
    time_frames: usize,
) -> Result<(), WriteFileError> {
    let verify = |reason: String| WriteFileError::verify(&out.join(LIST), reason);
    let back = trajectory::read(list, time_frames.max(2)).map_err(|e| verify(e.to_string()))?;
    let same = |((camera, t), (frame, _)): (&(m4_core::Camera, f64), &(&CaptureFrame, Places))| {
        let off = (camera.c2w.matrix() - frame.camera.c2w.matrix()).amax();
        off <= POSE_WITHIN * (1.0 + frame.camera.c2w.translation.amax())
            && (t - frame.t).abs() < 1e-6
            && camera.intrinsics == frame.camera.intrinsics
    };
    if back.len() != frames.len() || !back.iter().zip(frames).all(same) {
        return Err(verify("a camera is another one".to_owned()));
    }
    Ok(())
}

fn ply(points: &[CapturePoint]) -> Vec<u8> {
    let mut text = String::from("ply\nformat binary_little_endian 1.0\n");
    // Writing to a string cannot fail.
    let _ = writeln!(text, "element vertex {}", points.len());
    ["x", "y", "z"].iter().for_each(|name| {
        let _ = writeln!(text, "property float {name}");
    });
    ["red", "green", "blue"].iter().for_each(|name| {
        let _ = writeln!(text, "property uchar {name}");
    });
    text.push_str("end_header\n");
    let mut bytes = text.into_bytes();
    for point in points {
        point
            .position
            .iter()
            .for_each(|&v| bytes.extend((v as f32).to_le_bytes()));
        bytes.extend(point.colour);
    }
    bytes
}

fn losses(train: &Capture, unit: f64, clipped: usize) -> Vec<Loss> {
    let mut losses = Vec::new();
    if train.frames.iter().any(|f| f.depth.is_some()) {
        losses.push(Loss::Quantised(format!("depth to steps of {unit:.3e} world units")));
        if unit != UNIT {
            let flag = format!(
                "depth maps count {unit:e}, not nerfstudio's {UNIT}: give it --depth-unit-scale-factor {unit:e}"
            );
            losses.push(Loss::Quantised(flag));
        }
        if clipped > 0 {
            losses.push(Loss::Dropped(format!("{clipped} depths beyond {:.3}", 65535.0 * unit)));
        }
    }
    if train.tracks.is_some() {
        losses.push(Loss::Dropped("tracks".to_owned()));
    }
    losses
}
