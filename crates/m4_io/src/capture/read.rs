//! Reads a folder of posed frames as a [`Capture`].

use super::{CaptureOptions, Split};
use crate::dataset::nerfstudio::list_capture;
use crate::dataset::{ImportOptions, ReadSourceError, SourceErrorCause, load_of};
use m4_core::{Capture, Progress};
use std::io;
use std::path::{Path, PathBuf};

/// Bytes of eight pixels: colour, 16-bit depth and mask, 3 + 2 + 1/8 per pixel.
const BYTES_PER_8_PIXELS: u64 = 41;

/// Reads a split of a capture: `path` is its folder or one of its JSON files. The layout is that of
/// [the module](super); frames come sorted by time, poses in OpenCV axes, lens distortion is removed.
///
/// What was assumed (missing times) is reported to `progress`.
///
/// # Errors
///
/// [`ReadSourceError`], which names the file and the frame at fault.
pub fn read(
    path: &Path,
    split: Split,
    options: &CaptureOptions,
    progress: &dyn Progress,
) -> Result<Capture, ReadSourceError> {
    let file = list_of_frames(path, split);
    if !file.exists() {
        let what = "it does not exist; a capture is a folder with transforms_train.json, or such a file";
        return Err(SourceErrorCause::Io(io::Error::new(io::ErrorKind::NotFound, what)).at(&file));
    }
    let options = ImportOptions {
        max_memory_bytes: options.max_memory_bytes,
        reach: options.reach,
        ..ImportOptions::default()
    };
    let listing = list_capture(&file, split, &options, progress)?;
    Ok(load_of(&file, listing, BYTES_PER_8_PIXELS, &options, progress)?.train)
}

/// The JSON file that `path` stands for.
fn list_of_frames(path: &Path, split: Split) -> PathBuf {
    if !path.is_dir() {
        return path.to_path_buf();
    }
    let named = path.join(split.file_name());
    let lone = path.join("transforms.json");
    if split == Split::Train && !named.exists() && lone.exists() {
        lone
    } else {
        named
    }
}
