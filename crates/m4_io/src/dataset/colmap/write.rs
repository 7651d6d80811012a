//! Writes a capture as COLMAP's folders, for COLMAP and tools that train on its models.
//!
//! ```text
//! images/00000.png       the training frames
//! masks/00000.png.png    0 in dynamic regions, as COLMAP names and reads masks
//! sparse/0/*.bin         PINHOLE cameras, poses (world to camera, OpenCV axes), points of static regions (error -1, no track)
//! ```

use super::binary;
use super::tables::{ColmapPoint, ColmapTables, read_points, read_tables};
use crate::WriteError;
use crate::dataset::export::{FramePaths, Staging, check, static_points, write_frames};
use crate::scene::{Loss, Written, plural};
use m4_core::{Capture, Progress};
use std::fs;
use std::path::Path;

/// Most points: the order of what COLMAP itself makes of a few hundred images.
const MAX_POINTS: usize = 100_000;

/// Writes the training frames `capture` into the folder `out`, where `images`, `masks` and `sparse` are replaced.
///
/// # Errors
///
/// [`WriteError`]: nothing is then changed, unless the last renames fail.
pub fn write(out: &Path, capture: &Capture, progress: &dyn Progress) -> Result<Written, WriteError> {
    check(out, capture)?;
    let staging = Staging::new(out)?;
    let name = |i: usize| format!("{i:05}.png");
    let frames = capture.frames.iter().enumerate().map(|(i, frame)| {
        let paths = FramePaths {
            image: format!("images/{}", name(i)),
            mask: frame.mask.as_ref().map(|_| format!("masks/{}.png", name(i))),
            depth: None,
        };
        (frame, paths)
    });
    write_frames(staging.path(), out, &frames.collect::<Vec<_>>(), 1.0, progress)?;
    let points: Vec<ColmapPoint> = static_points(capture, MAX_POINTS);
    let cameras: Vec<_> = capture.frames.iter().map(|f| f.camera).collect();
    let tables = ColmapTables::new(&cameras, (0..cameras.len()).map(name));
    write_model(&staging.path().join("sparse/0"), &tables, &points)?;
    Ok(Written {
        path: out.to_path_buf(),
        bytes: staging.commit("sparse")?,
        splats: 0,
        losses: losses(capture, points.len()),
    })
}

/// Writes the three binary files and reads them back.
fn write_model(folder: &Path, tables: &ColmapTables, points: &[ColmapPoint]) -> Result<(), WriteError> {
    fs::create_dir_all(folder).map_err(|e| WriteError::io(folder, e))?;
    for (name, bytes) in [
        ("cameras.bin", binary::cameras(&tables.cameras)),
        ("images.bin", binary::images(&tables.images)),
        ("points3D.bin", binary::points(points)),
    ] {
        let path = folder.join(name);
        fs::write(&path, bytes).map_err(|e| WriteError::io(&path, e))?;
    }
    let verify = |reason: String| WriteError::verify(folder, reason);
    let back = read_tables(folder).and_then(|tables| Ok((tables, read_points(folder)?)));
    let (read, read_points) = back.map_err(|e| verify(e.to_string()))?;
    if read != *tables || read_points != points {
        return Err(verify("a camera, pose or point differs".into()));
    }
    Ok(())
}

fn losses(capture: &Capture, points: usize) -> Vec<Loss> {
    let mut losses = vec![Loss::Dropped("when the images were taken".to_owned())];
    if capture.frames.iter().any(|f| f.depth.is_some()) {
        losses.push(Loss::Dropped(format!("depth, but for {}", plural(points, "point"))));
    }
    if capture.tracks.is_some() {
        losses.push(Loss::Dropped("tracks".to_owned()));
    }
    losses
}
