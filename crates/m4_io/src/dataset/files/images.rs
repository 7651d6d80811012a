//! Images of known size: files of a folder, frames of a video; and the pinholes that fit them.

use super::Inside;
use crate::dataset::{FrameSource, ImportOptions};
use crate::error::AtPath;
use crate::video::{self, VideoOptions};
use crate::{Fault, ReadError, image};
use m4_core::{Intrinsics, Progress, RgbImage};
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
pub(crate) fn of_file(path: &Path) -> Result<StoredImage, ReadError> {
    let size = size_of(path)?;
    let file = path.to_path_buf();
    let rgb = FrameSource::new(move || Ok(image::read_rgb(&file)?));
    Ok(StoredImage { size, rgb })
}

/// The images of a folder in the natural order of their names, or the frames of a video.
pub(crate) fn read(
    path: &Path,
    inside: &Inside,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<StoredImages, ReadError> {
    inside.check(path).at(path)?;
    if path.is_dir() {
        let files = inside.files(video::image_files(path)?)?;
        let all = files.iter().map(|file| of_file(file)).collect::<Result<_, _>>()?;
        return Ok(StoredImages { all, times_s: None });
    }
    let as_stored = VideoOptions {
        size: None,
        strict: true,
        max_memory_bytes: options.max_memory_bytes,
        ..VideoOptions::default()
    };
    let clip = video::read(path, &as_stored, progress)?;
    clip.warnings.iter().for_each(|warning| progress.warn(warning));
    let times_s = clip.frames.iter().map(|frame| frame.time_s).collect();
    let all =
        clip.frames.into_iter().map(|frame| StoredImage { size: frame.rgb.size(), rgb: FrameSource::held(frame.rgb) });
    Ok(StoredImages { all: all.collect(), times_s: Some(times_s) })
}

/// Width and height of a PNG or JPEG file by its header, compared with the file's length.
pub(crate) fn size_of(path: &Path) -> Result<(usize, usize), ReadError> {
    let (width, height) = image::size(path)?;
    let file_bytes = std::fs::metadata(path).at(path)?.len();
    check_pixels(width, height, file_bytes).at(path)?;
    Ok((width, height))
}

/// Whether a packed image of `file_bytes` can have that size.
pub(crate) fn check_pixels(width: usize, height: usize, file_bytes: u64) -> Result<(), Fault> {
    let pixels = (width as u64).saturating_mul(height as u64);
    let most = file_bytes.saturating_mul(PIXELS_PER_BYTE).saturating_add(FREE_PIXELS);
    if pixels == 0 || pixels > most {
        let what = format!("{width} x {height} pixels are claimed by {file_bytes} bytes");
        return Err(Fault::bad(what, "the file is damaged; export it again"));
    }
    Ok(())
}

/// The pinhole `fx fy cx cy`, pixels, of images of that size.
pub(crate) fn pinhole([fx, fy, cx, cy]: [f64; 4], (width, height): (usize, usize)) -> Intrinsics {
    Intrinsics { width, height, fx, fy, cx, cy }
}

/// The lens of a camera for its images at another size: a side is rounded to a whole pixel, nothing is cut off or turned.
pub(crate) fn resized(k: &Intrinsics, (width, height): (usize, usize)) -> Result<Intrinsics, Fault> {
    let slack = 1.0 / width.min(height).max(1) as f64 + 1e-9;
    // by how much more the width is scaled than the height
    let aspect = (width as f64 / k.width as f64) / (height as f64 / k.height as f64);
    if (aspect - 1.0).abs() <= slack {
        return Ok(k.resized(width, height));
    }
    let (w, h) = (k.width, k.height);
    let what = format!("an image of {width} x {height} pixels where the camera is of {w} x {h}");
    let hint = if (width > height) == (w > h) {
        "give images that are not cropped"
    } else {
        "the images were rotated; use them in the sensor's orientation"
    };
    Err(Fault::bad(what, hint))
}
