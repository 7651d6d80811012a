//! Writes rendered images to their destination.

use super::Stop;
use crate::error::OutputError;
use crate::folder::{self, remove_file};
use crate::{Error, Refusal};
use m4_core::RgbImage;
use m4_io::{image, video::Mp4Writer};
use std::fs;
use std::path::{Path, PathBuf};

/// Video files that are not written, and would otherwise become folders.
const OTHER_VIDEOS: [&str; 8] = ["mov", "avi", "mkv", "webm", "m4v", "gif", "webp", "apng"];
/// Files for one image.
const IMAGE_EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];

/// The destination of images.
pub(super) enum Sink {
    /// `00000.png` and so on.
    Folder { path: PathBuf, next: usize },
    /// One image.
    Image(PathBuf),
    /// A clip.
    Video(Box<Mp4Writer>),
}

impl Sink {
    /// Refuses names that cannot work, before anything is computed.
    pub fn check(out: &Path, replace: bool) -> Result<(), Error> {
        let extension = extension(out);
        if OTHER_VIDEOS.contains(&extension.as_str()) {
            let path = out.display();
            return Err(Refusal::usage(format!(
                "{path} has the extension {extension}, which is not supported; name an .mp4 file, a .png file or a folder"
            ))
            .into());
        }
        if is_file(&extension) && out.exists() && !replace {
            return Err(OutputError::WouldReplace { path: out.to_path_buf() }.into());
        }
        Ok(())
    }

    /// Makes the place for the images of `stops`.
    pub fn open(out: &Path, stops: &[Stop], fps: f64, replace: bool) -> Result<Self, Error> {
        Self::check(out, replace)?;
        let path = out.to_path_buf();
        let extension = extension(out);
        if IMAGE_EXTENSIONS.contains(&extension.as_str()) {
            if stops.len() != 1 {
                let (path, frames) = (path.display(), stops.len());
                return Err(Refusal::usage(format!(
                    "{path} is one image, but the path has {frames}; name a folder or an .mp4 file, or choose one time with --path source \
                     --at T"
                ))
                .into());
            }
            return Ok(Self::Image(path));
        }
        if !is_file(&extension) {
            if folder::make(out)? && !replace {
                return Err(OutputError::WouldReplace { path }.into());
            }
            return Ok(Self::Folder { path, next: 0 });
        }
        let size = stops.first().map_or((0, 0), |s| (s.camera.intrinsics.width, s.camera.intrinsics.height));
        Ok(Self::Video(Box::new(Mp4Writer::create(out, size.0, size.1, fps)?)))
    }

    /// The next image.
    pub fn push(&mut self, rgb: &RgbImage) -> Result<(), Error> {
        match self {
            Self::Folder { path, next } => {
                image::write_rgb(&numbered(path, *next), rgb)?;
                *next += 1;
            }
            Self::Image(path) => image::write_rgb(path, rgb)?,
            Self::Video(writer) => writer.push(rgb)?,
        }
        Ok(())
    }

    /// Completes the file, or removes what an earlier and longer render left in the folder.
    pub fn finish(self) -> Result<(), Error> {
        match self {
            Self::Folder { path, next } => remove_from(&path, next),
            Self::Image(_) => Ok(()),
            Self::Video(writer) => Ok(writer.finish()?),
        }
    }
}

fn extension(out: &Path) -> String {
    out.extension().map_or_else(String::new, |e| e.to_string_lossy().to_lowercase())
}

fn is_file(extension: &str) -> bool {
    extension == "mp4" || IMAGE_EXTENSIONS.contains(&extension)
}

fn numbered(folder: &Path, i: usize) -> PathBuf {
    folder.join(format!("{i:05}.png"))
}

/// Removes the images from number `next` on, so that the folder holds one render.
fn remove_from(folder: &Path, next: usize) -> Result<(), Error> {
    let read = |source| Error::Read { path: folder.to_path_buf(), source };
    for entry in fs::read_dir(folder).map_err(read)? {
        let name = entry.map_err(read)?.file_name();
        let number = name.to_str().and_then(|n| n.strip_suffix(".png"));
        let number = number.filter(|n| n.len() == 5).and_then(|n| n.parse::<usize>().ok());
        if let Some(i) = number.filter(|i| *i >= next) {
            remove_file(&numbered(folder, i))?;
        }
    }
    Ok(())
}
