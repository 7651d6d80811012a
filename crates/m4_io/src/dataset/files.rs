//! The files of a source: which of them may be read, and what several formats share.
//!
//! Members of a zip archive or of the folder that it was unpacked to; a folder or a video as images
//! of known size, and lenses that fit them; frames per second and times in frames.

use super::{FrameSource, ImportOptions};
use crate::error::AtPath;
use crate::files::within_memory;
use crate::reach::Bounds;
use crate::video::{self, VideoOptions};
use crate::{Fault, ReadError, files, image, range};
use m4_core::{Intrinsics, Progress, RgbImage};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use zip::ZipArchive;
use zip::result::ZipError;

/// The bounds of a source: only files in its folder, and in those that the options name, are read.
#[derive(Debug, Clone)]
pub(crate) struct Inside(Bounds);

impl Inside {
    /// Of the source in `folder` whose images may lie where the options say.
    pub(crate) fn of(folder: &Path, options: &ImportOptions) -> Self {
        Self(Bounds::new(
            options.reach,
            folder,
            options.images.as_deref(),
        ))
    }

    /// Of what the user named beside the source: files in the folder `named`, or that file.
    pub(crate) fn named(named: &Path, options: &ImportOptions) -> Self {
        Self(Bounds::new(options.reach, named, []))
    }

    /// The file, if it may be read or is missing.
    pub(crate) fn check<P: AsRef<Path>>(&self, file: P) -> Result<P, Fault> {
        self.0.check(file.as_ref())?;
        Ok(file)
    }

    /// The same; the error names the file.
    pub(crate) fn file(&self, file: PathBuf) -> Result<PathBuf, ReadError> {
        self.0.check(&file).at(&file)?;
        Ok(file)
    }

    /// Checks many files.
    pub(crate) fn files(&self, files: Vec<PathBuf>) -> Result<Vec<PathBuf>, ReadError> {
        files.into_iter().map(|file| self.file(file)).collect()
    }
}

/// An archive, or the folder that it was unpacked to. Reading takes one member at a time from an
/// archive.
#[derive(Debug)]
pub(crate) enum Members {
    Folder {
        root: PathBuf,
        inside: Inside,
    },
    /// With its bytes.
    Zip(Mutex<ZipArchive<BufReader<File>>>, u64),
}

impl Members {
    /// Opens it; the directory of an archive is read here. Of a folder files are read that are
    /// `inside`.
    pub(crate) fn open(path: &Path, inside: Inside) -> Result<Self, Fault> {
        if path.is_dir() {
            let root = path.to_path_buf();
            return Ok(Self::Folder { root, inside });
        }
        let file = files::open(path)?;
        let bytes = file.metadata()?.len();
        let archive = ZipArchive::new(BufReader::new(file));
        let archive = archive.map_err(|e| {
            Fault::bad(
                format!("it is not a zip archive, or a damaged one ({e})"),
                "copy it again",
            )
        })?;
        Ok(Self::Zip(Mutex::new(archive), bytes))
    }

    /// Names of the files in `folder` (one level), without it.
    pub(crate) fn names(&self, folder: &str) -> Result<Vec<String>, Fault> {
        match self {
            Self::Folder { root, .. } => {
                let inner = root.join(folder);
                if !inner.is_dir() {
                    return Ok(Vec::new());
                }
                let names = std::fs::read_dir(inner)?
                    .map(|e| Ok(e?.file_name().to_string_lossy().into_owned()));
                names.collect()
            }
            Self::Zip(archive, _) => {
                let archive = archive.lock().map_err(|_| poisoned())?;
                let start = format!("{folder}/");
                let inside = archive.file_names().flatten().filter_map(|n| {
                    let name = n.strip_prefix(start.as_str())?;
                    (!name.is_empty() && !name.contains('/')).then(|| name.to_owned())
                });
                Ok(inside.collect())
            }
        }
    }

    /// Whether there is a file of that name.
    pub(crate) fn has(&self, name: &str) -> Result<bool, Fault> {
        match self {
            Self::Folder { root, .. } => Ok(root.join(name).is_file()),
            Self::Zip(archive, _) => Ok(archive
                .lock()
                .map_err(|_| poisoned())?
                .index_for_name(name)
                .is_some()),
        }
    }

    /// All bytes of one, `limit_bytes` at most; `None` if it is missing.
    pub(crate) fn read(&self, name: &str, limit_bytes: u64) -> Result<Option<Vec<u8>>, Fault> {
        let too_large = |needed_bytes| Fault::too_large(name, needed_bytes, limit_bytes);
        let mut out = Vec::new();
        match self {
            Self::Folder { root, inside } => {
                let path = inside.check(root.join(name))?;
                if !path.is_file() {
                    return Ok(None);
                }
                files::open(&path)?
                    .take(limit_bytes + 1)
                    .read_to_end(&mut out)?;
            }
            Self::Zip(archive, bytes) => {
                let mut archive = archive.lock().map_err(|_| poisoned())?;
                let unpacked = |e: String| {
                    Fault::bad(
                        format!("{name} cannot be unpacked ({e})"),
                        "copy the archive again",
                    )
                };
                let mut member = match archive.by_name(name) {
                    Ok(member) => member,
                    Err(ZipError::FileNotFound) => return Ok(None),
                    Err(e) => return Err(unpacked(e.to_string())),
                };
                if member.size() > limit_bytes {
                    return Err(too_large(member.size()));
                }
                within_memory(name, member.size(), *bytes)?;
                (&mut member)
                    .take(limit_bytes + 1)
                    .read_to_end(&mut out)
                    .map_err(|e| unpacked(e.to_string()))?;
            }
        }
        if out.len() as u64 > limit_bytes {
            return Err(too_large(out.len() as u64));
        }
        Ok(Some(out))
    }
}

fn poisoned() -> Fault {
    Fault::bad(
        "another thread failed while it read the archive",
        "read it again",
    )
}

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

/// A PNG or JPEG file, as it is stored: an orientation in its EXIF block is not applied, as no tool
/// that computes cameras does.
pub(crate) fn stored_image(path: &Path) -> Result<StoredImage, ReadError> {
    let size = image::size(path)?;
    let file = path.to_path_buf();
    let rgb = FrameSource::new(move || Ok(image::read_rgb(&file)?));
    Ok(StoredImage { size, rgb })
}

/// The images of a folder in the natural order of their names, or the frames of a video.
pub(crate) fn read_images(
    path: &Path,
    inside: &Inside,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<StoredImages, ReadError> {
    inside.check(path).at(path)?;
    if path.is_dir() {
        let files = inside.files(video::image_files(path)?)?;
        let all = files
            .iter()
            .map(|file| stored_image(file))
            .collect::<Result<_, _>>()?;
        return Ok(StoredImages { all, times_s: None });
    }
    let as_stored = VideoOptions {
        size: None,
        strict: true,
        max_memory_bytes: options.max_memory_bytes,
        ..VideoOptions::default()
    };
    let clip = video::read(path, &as_stored, progress)?;
    clip.warnings
        .iter()
        .for_each(|warning| progress.warn(warning));
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

/// The pinhole `fx fy cx cy`, pixels, of images of that size.
pub(crate) fn pinhole([fx, fy, cx, cy]: [f64; 4], (width, height): (usize, usize)) -> Intrinsics {
    Intrinsics {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
    }
}

/// The lens of a camera for its images at another size: a side is rounded to a whole pixel, nothing
/// is cut off or turned.
pub(crate) fn resized(
    k: &Intrinsics,
    (width, height): (usize, usize),
) -> Result<Intrinsics, Fault> {
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

/// Frames per second where nothing says it.
pub(crate) const DEFAULT_FPS: f64 = 30.0;

/// Frames per second of the options, checked.
pub(crate) fn given_fps(options: &ImportOptions) -> Result<Option<f64>, Fault> {
    match options.fps {
        Some(fps) => fps_of("the option fps", fps).map(Some),
        None => Ok(None),
    }
}

/// Frames per second as a file or an option gives them, checked.
pub(crate) fn fps_of(field: &str, fps: f64) -> Result<f64, Fault> {
    range::check(field, fps, &range::FPS, "frames per second", "give another")?;
    Ok(fps)
}

/// Seconds from the first of `frames` frames to the last, at the frames per second of the options,
/// else 30 with a warning.
pub(crate) fn duration_s(
    frames: usize,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Option<f64> {
    let fps = options.fps.unwrap_or_else(|| {
        progress.warn(&format!(
            "the source does not state its frame rate; {DEFAULT_FPS} frames per second are assumed (fps)"
        ));
        DEFAULT_FPS
    });
    Some((frames.max(1) - 1) as f64 / fps)
}

/// The same of a clip whose last frame is at `last_s` seconds, where it is known and the options do
/// not say otherwise.
pub(crate) fn duration_of(
    last_s: Option<f64>,
    frames: usize,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Option<f64> {
    match last_s {
        Some(last) if options.fps.is_none() => Some(last),
        _ => duration_s(frames, options, progress),
    }
}

/// Moments of each frame, in order and of any unit, as places in frames `0 ..= n - 1`, and the time
/// from the first to the last.
pub(crate) fn in_frames(moments: &[f64]) -> (Vec<f64>, f64) {
    let (first, last) = (
        moments.first().copied().unwrap_or(0.0),
        moments.last().copied().unwrap_or(0.0),
    );
    let (n, span) = (moments.len().max(1) as f64 - 1.0, last - first);
    let passes = span > 0.0;
    if !passes {
        return ((0..moments.len()).map(|i| i as f64).collect(), 0.0);
    }
    let place = |s: &f64| ((s - first) / span * n).clamp(0.0, n);
    (moments.iter().map(place).collect(), span)
}
