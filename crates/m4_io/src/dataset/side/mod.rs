//! Files of depth, masks and tracks: those of formats, and those from another tool for a clip of any format.
//!
//! ```text
//! options.depth, masks, tracks -> attach() -> the frames of a listing
//!
//! depth   folder of maps, one a training frame in natural order of names, or an npz stack (depths | depth | depth_map | arr_0:
//!         [n][h][w] or [n][h][w][1])
//!           .exr   first of the channels Z, depth, Y, R; half or float                 .pfm   one channel, rows from the bottom
//!           .png   16 bits per pixel, times ImportOptions::depth_unit                    .npy   [h][w]; integers times depth_unit
//! masks   folder, one a training frame, or an npz stack (masks | mask | dyn_masks | arr_0)
//!           .png   not 0 moves: a number of a palette (DAVIS, SAM 2), a grey value or a colour    .jpg  128 and more moves
//! tracks  npz   TAPIP3D, SpatialTracker v2: coords [n][k][3], visibs, extrinsics
//!               SpatialTracker v1: pred_tracks [n][k][3], pixels and z-depth; CoTracker: tracks or pred_tracks [n][k][2], pixels
//! ```
//!
//! What is converted: NaN, infinite and negative depth become 0 (unknown); PFM's rows are turned; places in pixels are counted
//! from the centre of the first pixel there and from the corner here; coordinates of a world whose cameras the file brings
//! (`extrinsics`, world to camera) go through those cameras to ours.

pub mod depth;
pub mod mask;
pub mod tracks;

use super::files::Inside;
use super::{FrameSource, ImportOptions, ListedFrame, Listing};
use crate::error::AtPath;
use crate::files::listed;
use crate::{Fault, ReadError};
use m4_core::Progress;
use std::path::{Path, PathBuf};

/// Gives the training frames of `listing` the depth, masks and tracks that `options` name, one map for each frame.
pub fn attach(listing: &mut Listing, options: &ImportOptions, progress: &dyn Progress) -> Result<(), ReadError> {
    if let Some(path) = &options.depth {
        let unit = depth::unit(options, depth::DEFAULT_UNIT).at(path)?;
        attach_depth(&mut listing.train, path, unit, options, progress)?;
    }
    if let Some(path) = &options.masks {
        attach_masks(&mut listing.train, path, options, progress)?;
    }
    if let Some(path) = &options.tracks {
        let read = tracks::read_tracks(path, &listing.train, options.max_memory_bytes, progress);
        listing.tracks = Some(read.at(path)?);
    }
    Ok(())
}

fn attach_depth(
    frames: &mut [ListedFrame],
    path: &Path,
    unit: f64,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<(), ReadError> {
    if path.is_dir() {
        let files = one_a_frame(path, depth::EXTENSIONS, "depth maps", frames.len())?;
        let files = Inside::named(path, options).files(files)?;
        for (frame, file) in frames.iter_mut().zip(files) {
            frame.depth = Some(depth::source(file, unit, 1.0));
        }
        return Ok(());
    }
    let stack = depth::read_stack(path, frames.len(), unit, options.max_memory_bytes, progress);
    for (frame, map) in frames.iter_mut().zip(stack.at(path)?) {
        frame.depth = Some(FrameSource::new(move || Ok(map.clone())));
    }
    Ok(())
}

fn attach_masks(
    frames: &mut [ListedFrame],
    path: &Path,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<(), ReadError> {
    let invert = options.invert_masks;
    if path.is_dir() {
        let files = one_a_frame(path, mask::EXTENSIONS, "masks", frames.len())?;
        let files = Inside::named(path, options).files(files)?;
        for (frame, file) in frames.iter_mut().zip(files) {
            let of_things = file.clone();
            frame.mask = Some(FrameSource::new(move || Ok(named(&file, mask::read_mask(&file, invert))?.mask)));
            let with_palette = mask::has_objects(&of_things) && !invert;
            frame.instances = with_palette.then(|| {
                FrameSource::new(move || {
                    let read = named(&of_things, mask::read_mask(&of_things, false))?;
                    read.instances.ok_or_else(|| {
                        let what = format!("{} lost its palette", of_things.display());
                        Fault::bad(what, "do not change files while they are read")
                    })
                })
            });
        }
        return Ok(());
    }
    let stack = mask::read_stack(path, frames.len(), invert, options.max_memory_bytes, progress);
    for (frame, mask) in frames.iter_mut().zip(stack.at(path)?) {
        frame.mask = Some(FrameSource::new(move || Ok(mask.clone())));
        frame.instances = None;
    }
    Ok(())
}

/// The files of a folder, as many as there are training frames.
pub(crate) fn one_a_frame(
    folder: &Path,
    extensions: &[&str],
    what: &str,
    frames: usize,
) -> Result<Vec<PathBuf>, ReadError> {
    let files = listed(folder, extensions)?;
    if files.len() == frames {
        return Ok(files);
    }
    let end = match (files.first(), files.last()) {
        (Some(first), Some(last)) => {
            let name = |p: &Path| p.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            format!(" ({} to {})", name(first), name(last))
        }
        _ => format!(" (names that end in .{})", extensions.join(", .")),
    };
    let what = format!("{} {what}{end} for {frames} training frames", files.len());
    Err(Fault::bad(what, "give one for each training frame, in the order of their names").at(folder))
}

/// With the file's name in the message, for faults that do not have it.
fn named<T>(file: &Path, read: Result<T, Fault>) -> Result<T, Fault> {
    read.map_err(|e| e.of_file(file))
}
