//! Writes numbered images into a folder, several at a time.

use crate::Error;
use m4_core::RgbImage;
use m4_io::WriteError;
use m4_io::image;
use std::collections::VecDeque;
use std::panic::resume_unwind;
use std::path::PathBuf;
use std::thread::{self, JoinHandle};

/// Writes images in threads of their own, as many at a time as the pool has.
pub(in crate::render) struct ImageWriters {
    folder: PathBuf,
    next: usize,
    most: usize,
    running: VecDeque<JoinHandle<Result<(), WriteError>>>,
}

impl ImageWriters {
    pub fn new(folder: PathBuf) -> Self {
        Self {
            folder,
            next: 0,
            most: rayon::current_num_threads(),
            running: VecDeque::new(),
        }
    }

    /// Writes the next image. Fails if an earlier one could not be written, or no thread can be
    /// started.
    pub fn push(&mut self, rgb: RgbImage) -> Result<(), Error> {
        while self.running.len() >= self.most {
            self.oldest()?;
        }
        let path = self.folder.join(numbered(self.next));
        self.next += 1;
        let thread = thread::Builder::new()
            .name("image".to_owned())
            .spawn(move || image::write_rgb(&path, &rgb));
        let no_thread = |error| Error::internal(format!("no thread can be started: {error}"));
        self.running.push_back(thread.map_err(no_thread)?);
        Ok(())
    }

    /// Waits for all images. Fails if one could not be written.
    pub fn finish(mut self) -> Result<(), Error> {
        while !self.running.is_empty() {
            self.oldest()?;
        }
        Ok(())
    }

    fn oldest(&mut self) -> Result<(), Error> {
        let Some(thread) = self.running.pop_front() else {
            return Ok(());
        };
        Ok(thread.join().unwrap_or_else(|panic| resume_unwind(panic))?)
    }
}

impl Drop for ImageWriters {
    /// Waits, so that no image appears in a folder that was given up.
    fn drop(&mut self) {
        self.running
            .drain(..)
            .for_each(|thread| drop(thread.join()));
    }
}

/// The name of image `i`.
pub(super) fn numbered(i: usize) -> String {
    format!("{i:05}.png")
}
