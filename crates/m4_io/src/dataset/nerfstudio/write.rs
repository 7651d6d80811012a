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

use super::{Frame, LensKeys, Transforms, rows};
use crate::capture::{depth_unit, farthest};
use crate::dataset::colmap::ColmapPoint;
use crate::dataset::export::{FramePaths, Staging, check, static_points, write_frames};
use crate::scene::{Loss, Written};
use crate::{WriteError, trajectory};
use m4_core::{Capture, CaptureFrame, Progress};
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
/// On failure nothing is changed, unless the last renames fail.
pub fn write(
    out: &Path,
    train: &Capture,
    test: Option<&Capture>,
    progress: &dyn Progress,
) -> Result<Written, WriteError> {
    check(out, train)?;
    if let Some(test) = test {
        check(out, test)?;
    }
    let staging = Staging::new(out)?;
    let held_out = test.map_or(&[][..], |t| &t.frames);
    let named = |prefix: &'static str| move |(i, frame): (usize, _)| (frame, paths(prefix, i, frame));
    let frames: Vec<(&CaptureFrame, FramePaths)> =
        train.frames.iter().enumerate().map(named("")).chain(held_out.iter().enumerate().map(named("test_"))).collect();
    let unit = unit(train);
    let points = static_points(train, MAX_POINTS);
    let list = list(train, &frames, unit, !points.is_empty());
    let clipped = write_frames(staging.path(), out, &frames, unit, progress)?;
    let put = |name: &str, bytes: &[u8]| {
        let path = staging.path().join(name);
        let io = |e| WriteError::io(&out.join(name), e);
        fs::write(&path, bytes).map_err(io)?;
        match fs::read(&path).map_err(io)? == bytes {
            true => Ok(()),
            false => Err(WriteError::verify(&out.join(name), "its bytes differ")),
        }
    };
    if !points.is_empty() {
        put(POINTS, &ply(&points))?;
    }
    let mut text = serde_json::to_vec_pretty(&list).map_err(|e| WriteError::io(&out.join(LIST), e.into()))?;
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

fn paths(prefix: &str, i: usize, frame: &CaptureFrame) -> FramePaths {
    let file = |folder: &str| format!("{folder}/{prefix}{i:05}.png");
    FramePaths {
        image: file("images"),
        mask: frame.mask.as_ref().map(|_| file("masks")),
        depth: frame.depth.as_ref().map(|_| file("depths")),
    }
}

/// Millimetres where these are neither too coarse nor too few.
fn unit(train: &Capture) -> f64 {
    if (LEAST_FAR..=65535.0 * UNIT).contains(&f64::from(farthest(train))) { UNIT } else { depth_unit(train) }
}

fn list(train: &Capture, frames: &[(&CaptureFrame, FramePaths)], unit: f64, points: bool) -> Transforms<Frame> {
    let last = train.time_frames.max(2) as f64 - 1.0;
    let (own, held_out) = frames.split_at(train.frames.len());
    let names = |from: &[(&CaptureFrame, FramePaths)]| {
        let names: Vec<String> = from.iter().map(|(_, paths)| paths.image.clone()).collect();
        Some(names).filter(|_| !held_out.is_empty())
    };
    let entry = |(frame, paths): &(&CaptureFrame, FramePaths)| Frame {
        file_path: paths.image.clone(),
        mask_path: paths.mask.clone(),
        depth_file_path: paths.depth.clone(),
        time: Some(frame.t / last),
        lens: LensKeys::pinhole(&frame.camera.intrinsics),
        transform_matrix: Some(rows(&frame.camera.c2w)),
        ..Frame::default()
    };
    Transforms {
        lens: LensKeys { camera_model: Some("OPENCV".to_owned()), ..LensKeys::default() },
        depth_unit_scale_factor: Some(unit),
        duration_s: train.duration_s,
        train_filenames: names(own),
        val_filenames: names(held_out),
        test_filenames: names(held_out),
        ply_file_path: points.then(|| POINTS.to_owned()),
        frames: frames.iter().map(entry).collect(),
        ..Transforms::default()
    }
}

fn read_back(
    list: &Path,
    out: &Path,
    frames: &[(&CaptureFrame, FramePaths)],
    time_frames: usize,
) -> Result<(), WriteError> {
    let verify = |reason: String| WriteError::verify(&out.join(LIST), reason);
    let back = trajectory::read(list, time_frames.max(2)).map_err(|e| verify(e.to_string()))?;
    let same = |((camera, t), (frame, _)): (&(m4_core::Camera, f64), &(&CaptureFrame, FramePaths))| {
        let off = (camera.c2w.matrix() - frame.camera.c2w.matrix()).amax();
        off <= POSE_WITHIN * (1.0 + frame.camera.c2w.translation.amax())
            && (t - frame.t).abs() < 1e-6
            && camera.intrinsics == frame.camera.intrinsics
    };
    if back.len() != frames.len() || !back.iter().zip(frames).all(same) {
        return Err(verify("a camera differs".to_owned()));
    }
    Ok(())
}

fn ply(points: &[ColmapPoint]) -> Vec<u8> {
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
        point.position.iter().for_each(|&v| bytes.extend((v as f32).to_le_bytes()));
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
