//! DAVIS: clips without poses, with manually annotated objects.
//!
//! ```text
//! JPEGImages/480p/NAME/00000.jpg      the video, 24 frames per second
//! Annotations/480p/NAME/00000.png     a palette image: the number of the object that each pixel shows, 0 for none
//! ```
//!
//! A [`Listing`](crate::dataset::Listing) is of posed frames, which these are not: [`read_clip`] gives what the estimation of
//! geometry starts from, a video, and its masks of objects. Source: the README of davischallenge/davis-2017.

use super::files::image_size;
use super::side::mask::read_mask;
use crate::error::AtPath;
use crate::files::stem;
use crate::video::{VideoOptions, image_files, read};
use crate::{Fault, ReadError};
use m4_core::{CompactIds, Progress, Video};
use std::path::{Path, PathBuf};

/// Frames per second of all clips.
const FPS: f64 = 24.0;

/// A clip and its annotated objects.
#[derive(Debug, Clone)]
pub struct DavisClip {
    /// The images.
    pub video: Video,
    /// The object that each pixel of each frame shows, of the size of the files; `None` for frames without annotation.
    pub instances: Vec<Option<CompactIds>>,
}

/// Whether a folder is that of the images of a clip (`.../JPEGImages/480p/NAME`).
#[must_use]
pub fn detect(path: &Path) -> bool {
    let named = |p: Option<&Path>| p.and_then(Path::file_name).is_some_and(|n| n == "JPEGImages");
    path.is_dir() && named(path.parent().and_then(Path::parent))
}

/// Reads the clip whose images lie in `path`, `ROOT/JPEGImages/RESOLUTION/NAME`; the maps lie in `ROOT/Annotations/RESOLUTION/NAME`.
/// `options` choose frames and size as for any video; its `folder_fps` is ignored.
/// Errors: another layout, images that cannot be read, or a map that has no palette or another size than its image.
pub fn read_clip(path: &Path, options: &VideoOptions, progress: &dyn Progress) -> Result<DavisClip, ReadError> {
    let annotations = annotations(path)?;
    let options = VideoOptions { folder_fps: FPS, ..options.clone() };
    let files = image_files(path)?;
    let video = read(path, &options, progress)?;
    let mut instances = Vec::with_capacity(video.frames.len());
    for frame in &video.frames {
        let index = (frame.time_s * FPS).round() as usize;
        let Some(image) = files.get(index) else {
            let what = format!("frame {index} is not among the {} images", files.len());
            return Err(Fault::bad(what, "do not change files while they are read").at(path));
        };
        let file = annotations.join(format!("{}.png", stem(image)));
        instances.push(if file.is_file() { Some(map(&file, image)?) } else { None });
    }
    Ok(DavisClip { video, instances })
}

fn annotations(path: &Path) -> Result<PathBuf, ReadError> {
    let parts = (path.file_name(), path.parent().and_then(Path::file_name));
    let root = path.parent().and_then(Path::parent).and_then(Path::parent);
    match (parts, root) {
        ((Some(name), Some(resolution)), Some(root)) if detect(path) => {
            Ok(root.join("Annotations").join(resolution).join(name))
        }
        _ => {
            let what = "it is not a folder ROOT/JPEGImages/RESOLUTION/NAME";
            Err(Fault::bad(what, "give the folder of the clip's images").at(path))
        }
    }
}

fn map(file: &Path, image: &Path) -> Result<CompactIds, ReadError> {
    let read = read_mask(file, false).at(file)?;
    let Some(ids) = read.instances else {
        let what = "it has no palette, so it does not distinguish objects";
        return Err(Fault::bad(what, "give the annotations as they were published").at(file));
    };
    let size = image_size(image)?;
    if ids.size() != size {
        let ((w, h), (pw, ph)) = (ids.size(), size);
        let what = format!("it is {w} x {h} pixels but its image is {pw} x {ph}");
        return Err(Fault::bad(what, "give images and annotations of one resolution").at(file));
    }
    Ok(ids)
}
