//! Depth and masks from another tool for a clip of any format, one file a training frame, in
//! natural order of names.
//!
//! ```text
//! options.depth    .exr  first of the channels Z, depth, Y, R    .npy  [h][w]    .png  16 bits, steps of 0.001 scene units
//! options.masks    .png  not black is dynamic: a number of a palette (DAVIS, SAM 2), a grey value or a colour
//! ```

use super::depth;
use super::files::Inside;
use super::{FrameSource, ImportOptions, Listing};
use crate::files::listed;
use crate::{Fault, ReadError, image};
use m4_core::CompactMask;
use std::path::{Path, PathBuf};

/// Gives the training frames of `listing` the depth and masks that `options` name, one map for each
/// frame.
pub(super) fn attach(listing: &mut Listing, options: &ImportOptions) -> Result<(), ReadError> {
    let frames = &mut listing.train;
    let files = |folder: &Path, extensions: &[&str], what: &str, n: usize| {
        Inside::named(folder, options).files(one_a_frame(folder, extensions, what, n)?)
    };
    if let Some(folder) = &options.depth {
        let files = files(folder, depth::EXTENSIONS, "depth maps", frames.len())?;
        for (frame, file) in frames.iter_mut().zip(files) {
            frame.depth = Some(depth::source(file, depth::DEFAULT_UNIT, 1.0));
        }
    }
    if let Some(folder) = &options.masks {
        let files = files(folder, &["png"], "masks", frames.len())?;
        for (frame, file) in frames.iter_mut().zip(files) {
            frame.mask = Some(mask(file));
            frame.instances = None;
        }
    }
    Ok(())
}

/// The mask of a PNG file when its turn comes.
pub(super) fn mask(file: PathBuf) -> FrameSource<CompactMask> {
    FrameSource::new(move || Ok(read_mask(&file)?))
}

/// Reads the mask of a PNG file: set where the image is not black.
pub fn read_mask(file: &Path) -> Result<CompactMask, ReadError> {
    // numbers of 16 bits first: as colours the small ones would be black
    Ok(match image::read_ids(file) {
        Ok(numbers) => numbers.to_mask(),
        Err(_) => image::read_rgb(file)?
            .map(|rgb| if *rgb == [0; 3] { 0 } else { 255 })
            .into(),
    })
}

/// The files of a folder, as many as there are training frames.
pub(super) fn one_a_frame(
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
            let name = |p: &Path| {
                p.file_name()
                    .map(|n| n.to_string_lossy().into_owned())
                    .unwrap_or_default()
            };
            format!(" ({} to {})", name(first), name(last))
        }
        _ => format!(" (names that end in .{})", extensions.join(", .")),
    };
    let what = format!("{} {what}{end} for {frames} training frames", files.len());
    Err(Fault::bad(
        what,
        "give one for each training frame, in the order of their names",
    )
    .at(folder))
}
