//! Pictures of known size: files of a folder, frames of a video.

use crate::core::{FrameSource, ImportOptions, ReadSourceError, SourceFault};
use m4_io::image;
use m4_io::video::{self, ReadVideoError, VideoOptions};
use m4_scene::{Intrinsics, Progress, RgbImage};
use std::path::{Component, Path, PathBuf};

/// How far the sides of a picture may be scaled differently: networks round sides to multiples of 14 or 16 pixels.
const ASPECT_WITHIN: f64 = 0.06;

/// A picture that is not decoded yet.
#[derive(Debug)]
pub(crate) struct Picture {
    pub name: String,
    /// `(width, height)`.
    pub size: (usize, usize),
    pub rgb: FrameSource<RgbImage>,
}

/// Pictures in order of time.
#[derive(Debug)]
pub(crate) struct Pictures {
    pub all: Vec<Picture>,
    /// Seconds of each from the first, where they are a video.
    pub times_s: Option<Vec<f64>>,
}

/// A PNG or JPEG file, as it is stored: an orientation in its EXIF block is not applied, as no tool that computes cameras does.
pub(crate) fn of_file(path: &Path) -> Result<Picture, SourceFault> {
    let size = image::size(path)?;
    let file = path.to_path_buf();
    Ok(Picture {
        name: path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        size,
        rgb: FrameSource::new(move || Ok(image::read_rgb(&file)?)),
    })
}

/// The pictures of a folder in the natural order of their names, or the frames of a video.
pub(crate) fn read(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Pictures, ReadSourceError> {
    if path.is_dir() {
        let files = video::pictures(path).map_err(|e| fault(e).at(path))?;
        let all = files.iter().map(|file| of_file(file).map_err(|fault| fault.at(file)));
        return Ok(Pictures {
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
    let clip = video::read(path, &as_stored, progress).map_err(|e| fault(e).at(path))?;
    clip.warnings.iter().for_each(|warning| progress.warn(warning));
    let times_s = clip.frames.iter().map(|frame| frame.time_s).collect();
    let all = clip.frames.into_iter().enumerate().map(|(i, frame)| Picture {
        name: format!("{i:05}"),
        size: frame.rgb.size(),
        rgb: FrameSource::held(frame.rgb),
    });
    Ok(Pictures {
        all: all.collect(),
        times_s: Some(times_s),
    })
}

fn fault(error: ReadVideoError) -> SourceFault {
    match error {
        ReadVideoError::Cancelled { .. } => SourceFault::Cancelled,
        ReadVideoError::Io { source, .. } => SourceFault::Io(source),
        other => SourceFault::unsupported(other.to_string(), "or give a folder of its pictures (pictures)"),
    }
}

/// `name`, as a file lists it, below `folder`; names that lead out of it are refused.
pub(crate) fn below(folder: &Path, name: &str) -> Result<PathBuf, SourceFault> {
    let inside = |part: Component<'_>| matches!(part, Component::Normal(_) | Component::CurDir);
    if name.is_empty() || !Path::new(name).components().all(inside) {
        let what = format!("the name {name:?} is not below the folder of the pictures");
        return Err(SourceFault::bad(what, "write names relative to that folder"));
    }
    Ok(folder.join(name))
}

/// Refuses a picture of another size than its camera, before it is decoded.
pub(crate) fn same_size(k: &Intrinsics, (width, height): (usize, usize)) -> Result<(), SourceFault> {
    if (k.width, k.height) == (width, height) {
        return Ok(());
    }
    let what = format!(
        "its picture is {width} x {height} but its camera is of {} x {} pixels",
        k.width, k.height
    );
    Err(SourceFault::bad(
        what,
        "give the pictures that the cameras were computed on",
    ))
}

/// A lens that was computed on pictures of its own size, for the same picture at another: sides are scaled, nothing is cut off.
pub(crate) fn scaled(k: &Intrinsics, (width, height): (usize, usize)) -> Result<Intrinsics, SourceFault> {
    let aspect = (width as f64 / k.width as f64) / (height as f64 / k.height as f64);
    if (aspect - 1.0).abs() > ASPECT_WITHIN {
        let what = format!(
            "the pictures are {width} x {height}, of another shape than the {} x {} that the cameras were computed on",
            k.width, k.height
        );
        return Err(SourceFault::bad(what, "give the pictures as the tool saw them"));
    }
    Ok(k.resized(width, height))
}
