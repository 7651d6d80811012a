//! Matches files to frames.

use super::GivenError;
use crate::Error;
use m4_core::Video;
use m4_io::video::image_files;
use std::collections::HashMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// A clip as far as files are to be found for its frames.
pub struct Clip {
    /// Number of frames.
    pub frames: usize,
    /// Their width and height.
    pub size: (usize, usize),
    /// Of a folder: all its images, and which of them the frames are.
    source: Option<(Vec<PathBuf>, Vec<usize>)>,
}

impl Clip {
    /// Of `video`, which was read from `input`.
    pub fn of(input: &Path, video: &Video, folder_fps: f64) -> Result<Self, Error> {
        let source = if input.is_dir() {
            let index = |time_s: f64| (time_s * folder_fps).round() as usize;
            let chosen = video.frames.iter().map(|f| index(f.time_s)).collect();
            Some((image_files(input)?, chosen))
        } else {
            None
        };
        Ok(Self {
            frames: video.frames.len(),
            size: video.frames.first().map_or((0, 0), |f| f.rgb.size()),
            source,
        })
    }

    /// The file in `folder` for every frame: by the names of the frames where they have names, else by order.
    pub fn files(&self, what: &'static str, folder: &Path) -> Result<Vec<PathBuf>, Error> {
        if !folder.is_dir() {
            let source = std::io::Error::new(std::io::ErrorKind::NotADirectory, "a folder was expected");
            let path = folder.to_path_buf();
            return Err(GivenError::Read { path, source }.into());
        }
        let files = image_files(folder)?;
        if let Some((all, chosen)) = &self.source {
            let by_name: HashMap<&OsStr, &PathBuf> = files.iter().filter_map(|p| Some((p.file_stem()?, p))).collect();
            let named = |&i: &usize| Some((*by_name.get(all.get(i)?.file_stem()?)?).clone());
            if let Some(named) = chosen.iter().map(named).collect::<Option<Vec<_>>>() {
                return Ok(named);
            }
        }
        self.in_order(what, folder, files)
    }

    /// One of `items` a frame, by order: they are as many as the frames, or as the images that the frames were chosen
    /// from.
    pub fn in_order<T: Clone>(&self, what: &'static str, path: &Path, items: Vec<T>) -> Result<Vec<T>, Error> {
        if items.len() == self.frames {
            return Ok(items);
        }
        if let Some((all, chosen)) = &self.source
            && items.len() == all.len()
            && let Some(chosen) = chosen.iter().map(|&i| items.get(i).cloned()).collect()
        {
            return Ok(chosen);
        }
        Err(GivenError::Count {
            what,
            path: path.to_path_buf(),
            found: items.len(),
            frames: self.frames,
        }
        .into())
    }
}
