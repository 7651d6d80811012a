//! Images of known size: files of a folder, frames of a video.

use super::Inside;
use crate::dataset::{FrameSource, ImportOptions, ReadSourceError, SourceErrorCause};
use crate::image;
use crate::video::{self, ReadVideoError, VideoOptions};
use m4_core::{Progress, RgbImage};
use std::path::Path;

/// Pixels that a byte of a packed image can stand for at most: deflate makes 1032 bytes of one, each of eight pixels of a bit; JPEG
/// about 400 pixels.
const PIXELS_PER_BYTE: u64 = 8 * 1032;
/// Pixels that are always read.
const FREE_PIXELS: u64 = 1 << 20;

/// An image that is not decoded yet.
#[derive(Debug)]
pub(crate) struct StoredImage {
    /// `(width, height)`.
    pub size: (usize, usize),
    pub rgb: FrameSource<RgbImage>,
}

/// Images in order of time.
#[derive(Debug)]
pub(crate) struct StoredImages {
    pub all: Vec<StoredImage>,
    /// Seconds of each from the first, where they are a video.
    pub times_s: Option<Vec<f64>>,
}

/// A PNG or JPEG file, as it is stored: an orientation in its EXIF block is not applied, as no tool that computes cameras does.
pub(crate) fn of_file(path: &Path) -> Result<StoredImage, SourceErrorCause> {
    let size = size_of(path)?;
    let file = path.to_path_buf();
    Ok(StoredImage {
        size,
        rgb: FrameSource::new(move || Ok(image::read_rgb(&file)?)),
    })
}

/// The images of a folder in the natural order of their names, or the frames of a video.
pub(crate) fn read(
    path: &Path,
    inside: &Inside,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<StoredImages, ReadSourceError> {
    inside.check(path).map_err(|e| e.at(path))?;
    if path.is_dir() {
        let files = video::image_files(path).map_err(|e| of_video(path, e))?;
        let one = |file: &Path| inside.check(file).and_then(of_file);
        let all = files.iter().map(|file| one(file).map_err(|e| e.at(file)));
        return Ok(StoredImages {
            all: all.collect::<Result<_, _>>()?,
            times_s: None,
        });
    }
    let as_stored = VideoOptions {
        size: None,
        strict: true,
        max_memory_bytes: options.max_memory_bytes,
        ..VideoOptions::default()
    };
    let clip = video::read(path, &as_stored, progress).map_err(|e| of_video(path, e))?;
    clip.warnings.iter().for_each(|warning| progress.warn(warning));
    let times_s = clip.frames.iter().map(|frame| frame.time_s).collect();
    let all = clip.frames.into_iter().map(|frame| StoredImage {
        size: frame.rgb.size(),
        rgb: FrameSource::held(frame.rgb),
    });
    Ok(StoredImages {
        all: all.collect(),
        times_s: Some(times_s),
    })
}

/// A video's error as that of a source; it names its file itself.
pub(crate) fn of_video(path: &Path, error: ReadVideoError) -> ReadSourceError {
    let cause = match error {
        ReadVideoError::Io { source, .. } => SourceErrorCause::Io(source),
        ReadVideoError::Image(e) => SourceErrorCause::Image(e),
        ReadVideoError::Cancelled { .. } => SourceErrorCause::Cancelled,
        other => {
            let unsupported = other.kind() == crate::ErrorKind::Unsupported;
            let (what, hint) = (other.to_string(), "or give a folder of its images");
            if unsupported {
                SourceErrorCause::unsupported(what, hint)
            } else {
                SourceErrorCause::bad(what, hint)
            }
        }
    };
    cause.at(path)
}

/// Width and height of a PNG or JPEG file by its header, compared with the file's length.
pub(crate) fn size_of(path: &Path) -> Result<(usize, usize), SourceErrorCause> {
    let (width, height) = image::size(path)?;
    check_pixels(width, height, std::fs::metadata(path)?.len())?;
    Ok((width, height))
}

/// Whether a packed image of `file_bytes` can have that size.
pub(crate) fn check_pixels(width: usize, height: usize, file_bytes: u64) -> Result<(), SourceErrorCause> {
    let pixels = (width as u64).saturating_mul(height as u64);
    let most = file_bytes.saturating_mul(PIXELS_PER_BYTE).saturating_add(FREE_PIXELS);
    if pixels == 0 || pixels > most {
        let what = format!("{width} x {height} pixels are claimed by {file_bytes} bytes");
        return Err(SourceErrorCause::bad(what, "the file is damaged; export it again"));
    }
    Ok(())
}
