//! A folder of images as a clip.

use super::plan::{self, Collector};
use super::{ReadVideoError, VideoOptions};
use crate::image;
use m4_core::{Progress, ResizeFilter, Video, resize_rgb};
use rayon::prelude::*;
use std::cmp::Ordering;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering as Atomic};

/// Reads the images of a folder in natural order (`2.png` before `10.png`), evenly spaced in time.
pub fn read(path: &Path, options: &VideoOptions, progress: &dyn Progress) -> Result<Video, ReadVideoError> {
    let files = image_files(path)?;
    let times: Vec<f64> = (0..files.len()).map(|i| i as f64 / options.folder_fps).collect();
    let kept = plan::select(path, &times, options)?;
    let expected = image::size(&files[0])?;
    for file in &files {
        let found = image::size(file)?;
        if found != expected {
            return Err(ReadVideoError::ImageSize {
                path: file.clone(),
                expected,
                found,
            });
        }
    }
    let longest = expected.0.max(expected.1) as f64;
    let size = plan::target_size(expected.0 as f64, expected.1 as f64, options);
    plan::check_memory(path, kept.len(), size, options)?;

    let done = AtomicUsize::new(0);
    let frames: Vec<Result<image::Photo, ReadVideoError>> = kept
        .par_iter()
        .map(|&i| {
            if progress.cancelled() {
                return Err(ReadVideoError::Cancelled {
                    path: path.to_path_buf(),
                });
            }
            let mut photo = image::read_photo(&files[i])?;
            let (w, h) = photo.rgb.size();
            let (width, height) = plan::target_size(w as f64, h as f64, options);
            if let Some(small) = resize_rgb(&photo.rgb, width, height, ResizeFilter::Triangle) {
                photo.rgb = small;
            }
            progress.update("read images", done.fetch_add(1, Atomic::Relaxed) + 1, kept.len(), "");
            Ok(photo)
        })
        .collect();
    let frames = frames.into_iter().collect::<Result<Vec<_>, _>>()?;
    // Images turned by their EXIF blocks may differ although the files agree.
    let upright = frames.first().map_or(size, |f| f.rgb.size());
    if let Some(i) = frames.iter().position(|f| f.rgb.size() != upright) {
        return Err(ReadVideoError::ImageSize {
            path: files[kept[i]].clone(),
            expected: upright,
            found: frames[i].rgb.size(),
        });
    }
    let scale = upright.0.max(upright.1) as f64 / longest;
    let focal_px = frames.first().and_then(|f| f.focal_px).map(|f| f * scale);
    let mut collector = Collector::new(upright);
    for (photo, &i) in frames.into_iter().zip(&kept) {
        collector.push(photo.rgb, times[i]);
    }
    let inside = times.iter().filter(|&&t| plan::in_range(t, options)).count();
    collector.warnings.extend(plan::thinned(kept.len(), inside));
    collector.finish(focal_px).ok_or_else(|| ReadVideoError::NoImages {
        path: path.to_path_buf(),
    })
}

/// The images (PNG, JPEG) of a folder in natural order: `2.png` before `10.png`; at least one.
///
/// # Errors
///
/// [`ReadVideoError`] if the folder cannot be read or has none.
pub fn image_files(path: &Path) -> Result<Vec<PathBuf>, ReadVideoError> {
    let io = |source| ReadVideoError::Io {
        path: path.to_path_buf(),
        source,
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(path).map_err(io)? {
        let file = entry.map_err(io)?.path();
        let hidden = file.file_name().is_none_or(|n| n.to_string_lossy().starts_with('.'));
        let extension = file.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        if !hidden && matches!(extension.as_deref(), Some("png" | "jpg" | "jpeg")) && file.is_file() {
            files.push(file);
        }
    }
    if files.is_empty() {
        return Err(ReadVideoError::NoImages {
            path: path.to_path_buf(),
        });
    }
    files.sort_by(|a, b| natural(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(files)
}

/// Compares text in which runs of digits count as numbers: `2.png` before `10.png`.
#[must_use]
pub fn natural(a: &str, b: &str) -> Ordering {
    let (mut a_rest, mut b_rest) = (a, b);
    loop {
        let (a_text, a_digits, a_next) = split(a_rest);
        let (b_text, b_digits, b_next) = split(b_rest);
        // Numbers of any length: without leading zeros, the longer is the larger.
        let number = |d: &str| {
            let d = d.trim_start_matches('0').to_owned();
            (d.len(), d)
        };
        let order = a_text.cmp(b_text).then_with(|| number(a_digits).cmp(&number(b_digits)));
        if order != Ordering::Equal {
            return order;
        }
        if a_next.is_empty() || b_next.is_empty() {
            return a_next.len().cmp(&b_next.len()).then_with(|| a.cmp(b));
        }
        (a_rest, b_rest) = (a_next, b_next);
    }
}

/// Text up to the first digit, the digits, and the rest.
fn split(s: &str) -> (&str, &str, &str) {
    let start = s.find(|c: char| c.is_ascii_digit()).unwrap_or(s.len());
    let (text, rest) = s.split_at(start);
    let end = rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len());
    let (digits, rest) = rest.split_at(end);
    (text, digits, rest)
}

#[cfg(test)]
mod tests {
    use super::natural;
    use std::cmp::Ordering;

    #[test]
    fn natural_order_compares_numbers() {
        let mut names = [
            "img10.png",
            "img2.png",
            "img002.png",
            "img1a3.png",
            "img1a20.png",
            "abc",
            "img",
        ];
        names.sort_by(|a, b| natural(a, b));
        let want = [
            "abc",
            "img",
            "img1a3.png",
            "img1a20.png",
            "img002.png",
            "img2.png",
            "img10.png",
        ];
        assert_eq!(names, want);
        assert_eq!(
            natural("99999999999999999999998", "99999999999999999999999"),
            Ordering::Less
        );
    }
}
