//! Writes a capture as COLMAP's folders, for COLMAP and tools that train on its models.
//!
//! ```text
//! images/00000.png       the training frames
//! masks/00000.png.png    0 in dynamic regions, as COLMAP names and reads masks
//! sparse/0/*.bin         PINHOLE cameras, poses (world to camera, OpenCV axes), points of static regions
//! ```

use super::WriteCaptureAsError;
use super::check::check;
use super::pictures::{self, Places};
use super::points::of_what_rests;
use super::staging::Staging;
use crate::cameras::colmap::{ColmapEncoding, ColmapPoint, Tables, write_tables};
use crate::scene::{Loss, Written, plural};
use m4_core::{Capture, Progress};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Settings of [`write()`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CaptureColmapOptions {
    /// Text or binary. Default: binary.
    pub encoding: ColmapEncoding,
    /// Most points. Default 100,000, the order of what COLMAP itself makes of a few hundred images.
    pub max_points: usize,
}

impl Default for CaptureColmapOptions {
    fn default() -> Self {
        Self {
            encoding: ColmapEncoding::Binary,
            max_points: 100_000,
        }
    }
}

/// Writes the training frames `capture` into the folder `out`, where `images`, `masks` and `sparse` are replaced.
///
/// # Errors
///
/// [`WriteCaptureAsError`]: nothing is then changed, unless the last renames fail.
pub fn write(
    out: &Path,
    capture: &Capture,
    options: &CaptureColmapOptions,
    progress: &dyn Progress,
) -> Result<Written, WriteCaptureAsError> {
    check(out, capture)?;
    let staging = Staging::new(out)?;
    let name = |i: usize| format!("{i:05}.png");
    let frames = capture.frames.iter().enumerate().map(|(i, frame)| {
        let places = Places {
            picture: format!("images/{}", name(i)),
            mask: frame.mask.as_ref().map(|_| format!("masks/{}.png", name(i))),
            depth: None,
        };
        (frame, places)
    });
    pictures::write(staging.path(), out, &frames.collect::<Vec<_>>(), 1.0, progress)?;
    let points = of_what_rests(capture, options.max_points)
        .into_iter()
        .map(|p| ColmapPoint {
            position: p.position,
            colour: p.colour,
        });
    let cameras: Vec<_> = capture.frames.iter().map(|f| f.camera).collect();
    let names = (0..cameras.len()).map(name).collect();
    let tables = Tables::new(&cameras, names, points.collect());
    write_tables(&staging.path().join("sparse/0"), &tables, options.encoding)?;
    let bytes = staging.commit("sparse")?;
    Ok(Written {
        path: out.to_path_buf(),
        bytes,
        splats: 0,
        losses: losses(capture, tables.points.len()),
    })
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
