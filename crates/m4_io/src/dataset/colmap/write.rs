//! Writes a capture for COLMAP and tools that train on its models.
//!
//! ```text
//! images/00000.png       the training frames
//! masks/00000.png.png    0 in dynamic regions, as COLMAP names and reads masks
//! sparse/0/*.bin         PINHOLE cameras, poses (world to camera, OpenCV axes), points of static regions (error -1, no track)
//! ```
//!
//! All of it is written to a folder beside its place, read back, and then gets its place
//! ([`crate::results`]).
//!
//! The dynamic part is 0 in the masks and left out of the points: readers rebuild the static part.

use super::tables::write_model;
use super::{ColmapPoint, ColmapTables};
use crate::files::in_parallel;
use crate::results::{Kind, ResultFolder};
use crate::scene::{Loss, Written, plural, usable};
use crate::{ReadError, WriteError, image};
use m4_core::{Capture, CaptureFrame, Exposure, Plane, Progress, SourceFrame};
use std::path::Path;

/// Most points: the order of what COLMAP itself makes of a few hundred images.
const MAX_POINTS: usize = 100_000;

/// Writes the training frames `capture` into the folder `out`, where `images`, `masks` and `sparse`
/// are replaced if they are of an earlier export; on failure nothing is changed.
pub fn write(
    out: &Path,
    capture: &Capture,
    progress: &dyn Progress,
) -> Result<Written, WriteError> {
    check(out, capture)?;
    let mut results = ResultFolder::open(out, Kind::Colmap)?;
    results.check_free(["images", "masks", "sparse"])?;
    let next = results.begin()?;
    let name = |i: usize| format!("{i:05}.png");
    let stopped = || WriteError::cancelled(out);
    in_parallel(
        "write frames",
        &capture.frames,
        progress,
        stopped,
        |i, frame| write_frame(&next, &name(i), frame),
    )?;
    let points = static_points(capture);
    let cameras: Vec<_> = capture.frames.iter().map(|f| f.camera).collect();
    let tables = ColmapTables::new(&cameras, (0..cameras.len()).map(name));
    write_model(&next.join("sparse/0"), &tables, &points)?;
    Ok(Written {
        path: out.to_path_buf(),
        bytes: results.commit(None)?,
        splats: 0,
        losses: losses(capture, points.len()),
    })
}

/// Refuses captures without frames, and invalid cameras.
fn check(out: &Path, capture: &Capture) -> Result<(), WriteError> {
    if capture.frames.is_empty() {
        return Err(WriteError::bad(out, "the capture has no frames"));
    }
    let last = capture.time_frames.max(2) as f64 - 1.0;
    for (i, frame) in capture.frames.iter().enumerate() {
        let bad = |what: String| {
            Err(WriteError::bad(
                out,
                format!("frame {i} ({}): {what}", frame.name),
            ))
        };
        if !(0.0..=last).contains(&frame.t) {
            return bad(format!(
                "it was taken at t = {}; 0 to {last} frames were expected",
                frame.t
            ));
        }
        let depth = frame.depth.as_ref().map(|d| d.size());
        let mask = frame.mask.as_ref().map(|m| m.size());
        if depth.into_iter().chain(mask).any(|(w, h)| w == 0 || h == 0) {
            return bad("its depth map or mask has no pixels".to_owned());
        }
        let camera = frame.camera;
        let source_frame = SourceFrame {
            camera,
            t: frame.t,
            exposure: Exposure::IDENTITY,
            distance_sigma: None,
        };
        if !usable(&source_frame) {
            return bad(format!("its camera is none: {camera:?}"));
        }
        let k = &camera.intrinsics;
        let (w, h) = frame.rgb.size();
        if (w, h) != (k.width, k.height) {
            return bad(format!(
                "its image is {w} x {h} pixels and its camera {} x {}",
                k.width, k.height
            ));
        }
    }
    Ok(())
}

/// Points of static pixels with known depth, at most [`MAX_POINTS`], spread evenly over frames and
/// pixels.
fn static_points(capture: &Capture) -> Vec<ColmapPoint> {
    let with_depth = capture.frames.iter().filter(|f| f.depth.is_some()).count();
    let mut points = Vec::new();
    if with_depth == 0 {
        return points;
    }
    let of_frame = (MAX_POINTS / with_depth).max(1);
    for frame in &capture.frames {
        let Some(depth) = &frame.depth else { continue };
        let (w, h) = depth.size();
        let (pw, ph) = frame.rgb.size();
        let step = ((w * h) as f64 / of_frame as f64).sqrt().ceil().max(1.0) as usize;
        // where the depth map has another size than the image
        let scale = [pw as f64 / w.max(1) as f64, ph as f64 / h.max(1) as f64];
        for y in (step / 2..h).step_by(step) {
            for x in (step / 2..w).step_by(step) {
                let z = f64::from(depth.at(x, y));
                if !(z > 0.0 && z.is_finite()) {
                    continue;
                }
                let (u, v) = ((x as f64 + 0.5) * scale[0], (y as f64 + 0.5) * scale[1]);
                if frame.mask.as_ref().is_some_and(|mask| {
                    let (mw, mh) = mask.size();
                    mask.at(
                        ((u * mw as f64 / pw as f64) as usize).min(mw.saturating_sub(1)),
                        ((v * mh as f64 / ph as f64) as usize).min(mh.saturating_sub(1)),
                    )
                }) {
                    continue;
                }
                // from the centre of the first pixel
                let position = frame.camera.unproject(u - 0.5, v - 0.5, z);
                points.push(ColmapPoint {
                    position: position.into(),
                    colour: frame.rgb[((u as usize).min(pw - 1), (v as usize).min(ph - 1))],
                });
            }
        }
    }
    points.truncate(MAX_POINTS);
    points
}

fn write_frame(folder: &Path, name: &str, frame: &CaptureFrame) -> Result<(), WriteError> {
    fn same<T>(
        path: &Path,
        back: Result<T, ReadError>,
        same: impl Fn(&T) -> bool,
    ) -> Result<(), WriteError> {
        match back {
            Ok(back) if same(&back) => Ok(()),
            Ok(_) => Err(WriteError::verify(path, "its pixels differ")),
            Err(e) => Err(WriteError::verify(path, e)),
        }
    }
    let path = folder.join("images").join(name);
    image::write_rgb(&path, &frame.rgb)?;
    same(&path, image::read_rgb(&path), |back| *back == frame.rgb)?;
    let Some(mask) = &frame.mask else {
        return Ok(());
    };
    let path = folder.join(format!("masks/{name}.png"));
    let ((w, h), (mw, mh)) = (frame.rgb.size(), mask.size());
    // readers expect the size of the image, and white where they train
    let is_static = Plane::from_fn(w, h, |x, y| {
        if mask.at(x * mw / w, y * mh / h) {
            0
        } else {
            255
        }
    });
    image::write_mask(&path, &is_static)?;
    same(&path, image::read_mask(&path), |back| {
        back.to_mask() == is_static
    })
}

fn losses(capture: &Capture, points: usize) -> Vec<Loss> {
    let mut losses = vec![Loss::Dropped("when the images were taken".to_owned())];
    if capture.frames.iter().any(|f| f.depth.is_some()) {
        losses.push(Loss::Dropped(format!(
            "depth, but for {}",
            plural(points, "point")
        )));
    }
    if capture.tracks.is_some() {
        losses.push(Loss::Dropped("tracks".to_owned()));
    }
    losses
}
